// What the stages of a prefix sum are told.

struct ScanParams {
    // Values.
    count: u32,
    reserved_a: u32,
    reserved_b: u32,
    reserved_c: u32,
}
