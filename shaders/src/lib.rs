//! The GPU contract.
