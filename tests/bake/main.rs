//! The bake from scene file to archive, through the real binary and through the library: the same bytes however it
//! runs, known answers, bad input, interruptions, recipes.

mod answers;
mod broken_files;
mod damage;
mod determinism;
mod faults;
mod interrupts;
mod reports;
mod rows;
mod scenes;
mod workplace;
