//! The bake: a glTF scene in, archive sections out.
pub mod appearance;
pub mod bake;
pub mod cube;
pub mod estimate;
pub mod generate;
pub mod glb;
pub mod import;
pub mod octree;
pub mod points;
pub mod recipe;
pub mod reduce;
pub mod rows;
pub mod run;
pub mod scene;
pub mod sections;
pub mod triangles;
