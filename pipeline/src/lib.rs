//! The bake: a glTF scene in, archive sections out.
pub mod appearance;
pub mod cube;
pub mod generate;
pub mod glb;
pub mod octree;
pub mod points;
pub mod reduce;
pub mod scene;
pub mod triangles;
