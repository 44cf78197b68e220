//! The GPU contract.
pub mod trig;
