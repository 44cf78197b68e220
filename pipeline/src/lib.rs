//! The bake: a glTF scene in, archive sections out.
pub mod generate;
pub mod glb;
pub mod scene;
