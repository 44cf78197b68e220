//! The bake: a glTF scene in, archive sections out.
pub mod scene;
