// How the view hierarchy is cut into nodes: ranges of the run's sorted keys. The stage has `keys` and `pass_params`.

const NO_DIGIT: u32 = 0xffffffffu;

// Which octal digit, from the lowest, is the highest in which the keys of two of the run's views differ.
fn differing_digit(a: u32, b: u32) -> u32 {
    let differing = keys[pass_params.run_start + a] ^ keys[pass_params.run_start + b];
    if differing.y != 0u {
        return 10u + firstLeadingBit(differing.y) / 3u;
    }
    if differing.x != 0u {
        return firstLeadingBit(differing.x) / 3u;
    }
    return NO_DIGIT;
}

fn key_digit(view: u32, digit: u32) -> u32 {
    let key = keys[pass_params.run_start + view];
    return select(key.x >> (3u * digit), key.y >> (3u * (digit - 10u)), digit >= 10u) & 7u;
}

// Whether views `range.x .. range.y`, which differ in `digit` at most, share a leaf.
fn is_shared(range: vec2<u32>, digit: u32) -> bool {
    let len = range.y - range.x;
    let in_voxel = digit == NO_DIGIT || digit + scene.depth < KEY_LEVELS;
    return len == 1u || (pass_params.sharing == 1u && len <= MOST_SHARED && in_voxel);
}

// Where the child that begins at `start` ends: at the first other digit, or if all keys are equal after an eighth.
fn child_end(start: u32, range: vec2<u32>, digit: u32) -> u32 {
    if digit == NO_DIGIT {
        return min(start + (range.y - range.x + 7u) / 8u, range.y);
    }
    let own = key_digit(start, digit);
    var low = start + 1u;
    var high = range.y;
    while low < high {
        let middle = (low + high) / 2u;
        if key_digit(middle, digit) == own {
            low = middle + 1u;
        } else {
            high = middle;
        }
    }
    return low;
}
