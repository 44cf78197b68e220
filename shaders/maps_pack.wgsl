// Puts the maps of the leaves one after the other, as 32-bit or 16-bit floats; behind them all, if wanted, their node numbers.
// A workgroup does a slice of a leaf's.

@group(0) @binding(0) var<uniform> pass_params: PassParams;
@group(0) @binding(1) var<storage, read> tree: array<u32>;
@group(0) @binding(2) var<storage, read> links: array<u32>;
@group(0) @binding(3) var<storage, read> maps: array<u32>;
@group(0) @binding(4) var<storage, read_write> packed: array<u32>;

// The nearest 16-bit float of a 32-bit one that is not negative; of two equally near ones the even.
fn half_bits(bits: u32) -> u32 {
    if bits >= 0x477ff000u {
        return 0x7c00u;
    }
    if bits < 0x38800000u {
        // Multiples of 2^-24, which are the last places of a sum with a half.
        return bitcast<u32>(bitcast<f32>(bits) + 0.5) - 0x3f000000u;
    }
    return (bits - 0x38000000u + 0xfffu + ((bits >> 13u) & 1u)) >> 13u;
}

@compute @workgroup_size(64)
fn main(@builtin(workgroup_id) group: vec3<u32>, @builtin(local_invocation_index) lane: u32) {
    let leaf = flat_group(group);
    if leaf >= tree[TREE_LEAVES] {
        return;
    }
    let map = links[pass_params.node_capacity + leaf] * pass_params.texels;
    let end = min((group.z + 1u) * MAP_SLICE, pass_params.texels);
    if pass_params.half_depths == 1u {
        let half_end = end / 2u;
        for (var pair = group.z * (MAP_SLICE / 2u) + lane; pair < half_end; pair += 64u) {
            let low = half_bits(maps[map + 2u * pair]);
            let high = half_bits(maps[map + 2u * pair + 1u]);
            packed[leaf * (pass_params.texels / 2u) + pair] = low | (high << 16u);
        }
    } else {
        for (var texel = group.z * MAP_SLICE + lane; texel < end; texel += 64u) {
            packed[leaf * pass_params.texels + texel] = maps[map + texel];
        }
    }
    if pass_params.with_numbers == 1u {
        let depth_words = select(pass_params.texels, pass_params.texels / 2u, pass_params.half_depths == 1u);
        let first = tree[TREE_LEAVES] * depth_words + leaf * pass_params.texels;
        for (var texel = group.z * MAP_SLICE + lane; texel < end; texel += 64u) {
            packed[first + texel] = maps[number_at(map + texel)];
        }
    }
}
