// What a texel keeps of what is drawn into it: the smallest distance; once all those are known the smallest number of the
// scene nodes at that distance. Both times a distance comes from the same instructions, so that its bits are the same. The
// stage has `maps` and `pass_params`.

fn keep(map: u32, texel: u32, distance: f32, node: u32) {
    let at = map * pass_params.texels + texel;
    let bits = bitcast<u32>(distance);
    let kept = atomicLoad(&maps[at]);
    // One atomic operation for both: software adapters pay for every one that they see.
    let draws_numbers = pass_params.draws_numbers == 1u;
    if select(bits < kept, bits == kept, draws_numbers) {
        atomicMin(&maps[select(at, number_at(at), draws_numbers)], select(bits, node, draws_numbers));
    }
}
