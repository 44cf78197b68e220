// What the stages that do one level of the view hierarchy are told.

struct LevelParams {
    level: u32,
    reserved_a: u32,
    reserved_b: u32,
    reserved_c: u32,
}
