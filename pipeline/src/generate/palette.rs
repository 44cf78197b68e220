//! The materials that generated scenes are made of.

use glam::{Vec3, Vec4, vec3};

use super::model::Brush;
use super::texture;
use crate::scene::{AlphaMode, Material, Scene, Texture};

/// Colours of house walls, linear in 1/255.
pub(super) const PLASTER: [[u8; 3]; 8] = [
    [222, 196, 148],
    [214, 160, 92],
    [196, 206, 190],
    [228, 222, 208],
    [206, 132, 100],
    [150, 178, 196],
    [232, 206, 110],
    [190, 120, 128],
];

/// Colours of roofs, linear in 1/255.
pub(super) const ROOFS: [[u8; 3]; 5] =
    [[150, 52, 32], [172, 72, 40], [118, 44, 34], [72, 66, 74], [128, 74, 48]];

/// Colours of doors, shutters and clothes, linear in 1/255.
pub(super) const PAINTS: [[u8; 3]; 8] = [
    [30, 70, 60],
    [110, 24, 22],
    [26, 48, 92],
    [150, 110, 30],
    [190, 186, 176],
    [70, 34, 60],
    [36, 30, 28],
    [40, 96, 40],
];

/// Colours of foliage, linear in 1/255.
pub(super) const FOLIAGE: [[u8; 3]; 5] =
    [[34, 72, 16], [48, 88, 20], [24, 60, 20], [80, 92, 18], [118, 66, 14]];

/// A brush for each material; making them adds the materials and textures to the scene.
#[derive(Debug, Clone, Copy)]
pub(super) struct Palette {
    pub(super) bricks: Brush,
    /// To be tinted.
    pub(super) plaster: Brush,
    /// To be tinted.
    pub(super) roof: Brush,
    /// To be tinted.
    pub(super) paint: Brush,
    pub(super) trim: Brush,
    pub(super) stone: Brush,
    pub(super) cobbles: Brush,
    pub(super) grass: Brush,
    pub(super) wood: Brush,
    pub(super) bark: Brush,
    /// Leaf cards, cut out by a mask. To be tinted.
    pub(super) leaf_cards: Brush,
    /// Opaque two-sided leaves and blades. To be tinted.
    pub(super) leaves: Brush,
    pub(super) metal: Brush,
    pub(super) water: Brush,
    pub(super) dark_glass: Brush,
    /// Warm light from inside.
    pub(super) lit_glass: Brush,
    /// Cooler light from inside.
    pub(super) cool_glass: Brush,
    /// Heads of lamps.
    pub(super) lamp: Brush,
    /// To be tinted.
    pub(super) skin: Brush,
}

const ANY_TINT: Option<[u8; 3]> = Some([255, 255, 255]);

impl Palette {
    /// Adds every material and texture to `scene`.
    pub(super) fn new(scene: &mut Scene) -> Self {
        let mut textured = |name: &str, texture: Texture, metres: f32, tint: Option<[u8; 3]>, mask: bool| {
            scene.textures.push(texture);
            scene.materials.push(Material {
                name: name.to_owned(),
                base_color_texture: Some(scene.textures.len() as u32 - 1),
                alpha_mode: if mask { AlphaMode::Mask { cutoff: 0.5 } } else { AlphaMode::Opaque },
                double_sided: mask,
                ..Material::default()
            });
            Brush { material: scene.materials.len() as u32 - 1, repeats_per_metre: Some(1.0 / metres), tint }
        };
        let bricks = textured("bricks", texture::bricks(), 1.2, None, false);
        let roof = textured("roof tiles", texture::roof_tiles(), 1.6, ANY_TINT, false);
        let cobbles = textured("cobbles", texture::cobbles(), 2.4, None, false);
        let grass = textured("lawn", texture::grass(), 7.0, None, false);
        let bark = textured("bark", texture::bark(), 1.5, None, false);
        let leaf_cards = textured("leaf cards", texture::leaves(), 1.0, ANY_TINT, true);
        let mut plain =
            |name: &str, color: Vec3, tint: Option<[u8; 3]>, emissive: Vec3, double_sided: bool| {
                scene.materials.push(Material {
                    name: name.to_owned(),
                    base_color: color.extend(1.0),
                    emissive,
                    double_sided,
                    ..Material::default()
                });
                Brush { material: scene.materials.len() as u32 - 1, repeats_per_metre: None, tint }
            };
        let dark = Vec3::ZERO;
        Self {
            bricks,
            plaster: plain("plaster", Vec3::splat(0.9), ANY_TINT, dark, false),
            roof,
            paint: plain("paint", Vec3::ONE, ANY_TINT, dark, false),
            trim: plain("trim", vec3(0.78, 0.76, 0.7), None, dark, false),
            stone: plain("stone", vec3(0.34, 0.325, 0.295), None, dark, false),
            cobbles,
            grass,
            wood: plain("wood", vec3(0.19, 0.1, 0.05), None, dark, false),
            bark,
            leaf_cards,
            leaves: plain("leaves", Vec3::ONE, ANY_TINT, dark, true),
            metal: plain("metal", vec3(0.06, 0.065, 0.07), None, dark, false),
            water: plain("water", vec3(0.05, 0.16, 0.2), None, dark, false),
            dark_glass: plain("dark glass", vec3(0.03, 0.04, 0.055), None, dark, false),
            // Powers of two times the strongest channel: files hold factor and strength without rounding.
            lit_glass: plain("lit glass", vec3(0.6, 0.45, 0.25), None, vec3(8.0, 4.5, 1.75), false),
            cool_glass: plain("cool glass", vec3(0.5, 0.55, 0.6), None, vec3(3.0, 3.5, 4.0), false),
            lamp: plain("lamp", vec3(0.9, 0.8, 0.6), None, vec3(32.0, 22.0, 11.0), false),
            skin: plain("skin", Vec3::ONE, ANY_TINT, dark, false),
        }
    }
}

/// Removes meshes without instances, and materials and textures that no mesh uses: a scene holds only what it shows.
pub(super) fn drop_unused(scene: &mut Scene) {
    let mut used_meshes = vec![false; scene.meshes.len()];
    for instance in &scene.instances {
        used_meshes[instance.mesh as usize] = true;
    }
    let mesh_index = new_indices(&used_meshes);
    for instance in &mut scene.instances {
        instance.mesh = mesh_index[instance.mesh as usize];
    }
    keep(&mut scene.meshes, &used_meshes);
    let mut used_materials = vec![false; scene.materials.len()];
    for mesh in &scene.meshes {
        used_materials[mesh.material as usize] = true;
    }
    let mut used_textures = vec![false; scene.textures.len()];
    for (material, _) in scene.materials.iter().zip(&used_materials).filter(|(_, used)| **used) {
        for texture in [material.base_color_texture, material.emissive_texture].into_iter().flatten() {
            used_textures[texture as usize] = true;
        }
    }
    let material_index = new_indices(&used_materials);
    let texture_index = new_indices(&used_textures);
    for mesh in &mut scene.meshes {
        mesh.material = material_index[mesh.material as usize];
    }
    keep(&mut scene.materials, &used_materials);
    keep(&mut scene.textures, &used_textures);
    for material in &mut scene.materials {
        let renumber = |texture: u32| texture_index[texture as usize];
        material.base_color_texture = material.base_color_texture.map(renumber);
        material.emissive_texture = material.emissive_texture.map(renumber);
    }
    debug_assert!(scene.materials.iter().all(|material| material.base_color.cmple(Vec4::ONE).all()));
}

/// For each item its index among the used ones.
fn new_indices(used: &[bool]) -> Vec<u32> {
    let mut next = 0;
    used.iter()
        .map(|used| {
            let index = next;
            next += u32::from(*used);
            index
        })
        .collect()
}

fn keep<T>(items: &mut Vec<T>, used: &[bool]) {
    let mut used = used.iter();
    items.retain(|_| used.next().copied().unwrap_or(false));
}
