//! Whole imports of tiny files made here, with known answers.

mod builder;
mod damage;
mod deformation;
mod features;
mod refusals;
