//! The bake: a glTF scene in, archive sections out.
pub mod import;
pub mod scene;
