//! Rebakes: what is made again after an edit and what is not, that the bytes are those of a clean bake, faults, watching,
//! build systems. `docs/rebakes.md` has the table of what invalidates what; `invalidation` has a test for each row.

#[path = "../bake/scenes.rs"]
#[allow(dead_code, reason = "the tests of the bake use the rest")]
mod scenes;
#[path = "../bake/workplace.rs"]
#[allow(dead_code, reason = "the tests of the bake use the rest")]
mod workplace;

mod build_systems;
mod edits;
mod explanations;
mod faults;
mod invalidation;
mod village;
mod watching;
