// Morton keys of views, and a stable sort of them by 8 bits at a time.

struct SortParams {
    // Views.
    count: u32,
    // Which 8 bits, from the lowest.
    digit: u32,
    // Runs of SORT_CHUNK views, each sorted by one invocation.
    chunks: u32,
    reserved: u32,
}

// Bits 8 `digit` and on of a key, whose low 30 bits are in the first word and whose high 9 are in the second.
fn sort_digit(key: vec2<u32>, digit: u32) -> u32 {
    if digit < 3u {
        return (key.x >> (8u * digit)) & 0xffu;
    }
    if digit == 3u {
        return (key.x >> 24u) | ((key.y & 3u) << 6u);
    }
    return key.y >> 2u;
}
