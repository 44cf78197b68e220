//! Pictures of what was baked: the octree ray-cast, slices of it, and the rows of a direction.
//!
//! `octree` traverses, `scene` looks attributes up, `camera` makes rays and `choose` finds a camera by itself; `view`
//! turns rays into buffers, `shade` lights them and `filter` smooths and tone-maps; `slice` and `rows` show data as it
//! is; `picture` and `output` hold and write results. Every picture depends on its inputs alone, not on threads.

mod camera;
mod choose;
mod filter;
mod octree;
#[cfg(feature = "bake")]
mod output;
mod picture;
mod rows;
mod scene;
mod shade;
mod slice;
mod view;

pub use camera::{Camera, CameraError, RayMaker};
pub use choose::{CameraChoice, choose_camera};
pub use octree::{Hit, Octree, Ray};
#[cfg(feature = "bake")]
pub use output::{NOTE_ATTRIBUTE, PictureFormat, write_exr, write_picture, write_png};
pub use picture::{Extra, Picture};
pub use rows::picture_rows;
pub use scene::{Scene, face_normal};
pub use slice::{Axis, picture_slice};
pub use view::{Cancelled, Mode, ViewSettings, picture_view};
#[cfg(feature = "bake")]
pub(crate) use {
    filter::{luminance, tone_mapped},
    picture::{display, heat},
};
