//! Materials that drawn primitives use, in the order of their first use.

use super::error::ImportError;
use super::json::Json;
use super::resources::Resources;
use super::textures::{Textures, UvUse};
use crate::scene::{AlphaMode, Material, Texture};
use glam::{Vec3, Vec4};
use std::collections::BTreeMap;

/// How primitives use a material.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct MaterialUse {
    /// Index into the scene's materials.
    pub(super) index: u32,
    /// Texture coordinates of the base colour texture, if there is one.
    pub(super) base_color_uv: Option<UvUse>,
    /// Texture coordinates of the emissive texture, if there is one.
    pub(super) emissive_uv: Option<UvUse>,
}

/// Materials and textures found so far.
#[derive(Debug, Default)]
pub(super) struct Materials {
    materials: Vec<Material>,
    uses: BTreeMap<Option<usize>, MaterialUse>,
    textures: Textures,
}

impl Materials {
    /// The material `index` of the file, or the default one.
    pub(super) fn get(
        &mut self,
        resources: &Resources<'_>,
        index: Option<usize>,
    ) -> Result<MaterialUse, ImportError> {
        if let Some(known) = self.uses.get(&index) {
            return Ok(*known);
        }
        let mut material = Material::default();
        let mut material_use =
            MaterialUse { index: self.materials.len() as u32, base_color_uv: None, emissive_uv: None };
        if let Some(index) = index {
            let object = resources.root.item("materials", index)?;
            self.read(resources, &object, &mut material, &mut material_use)?;
        }
        self.materials.push(material);
        self.uses.insert(index, material_use);
        Ok(material_use)
    }

    fn read(
        &mut self,
        resources: &Resources<'_>,
        object: &Json<'_>,
        material: &mut Material,
        material_use: &mut MaterialUse,
    ) -> Result<(), ImportError> {
        material.name = object.name();
        material.double_sided = object.boolean("doubleSided").unwrap_or(false);
        material.alpha_mode = match object.string("alphaMode")? {
            None | Some("OPAQUE") => AlphaMode::Opaque,
            Some("MASK") => AlphaMode::Mask { cutoff: object.number("alphaCutoff")?.unwrap_or(0.5) as f32 },
            Some("BLEND") => AlphaMode::Blend,
            Some(other) => {
                resources
                    .warn(format!("{}: \"{other}\" is none; OPAQUE is used", object.place_of("alphaMode")));
                AlphaMode::Opaque
            }
        };
        if let Some((factor, texture)) = base_color(resources, object)? {
            material.base_color = Vec4::from_array(factor.map(|value| value.clamp(0.0, 1.0) as f32));
            if let Some(texture) = texture {
                let (texture, uv) = self.textures.request(resources, &texture)?;
                material.base_color_texture = texture;
                material_use.base_color_uv = texture.map(|_| uv);
            }
        }
        let strength = match object.extension("KHR_materials_emissive_strength") {
            Some(extension) => extension.number("emissiveStrength")?.unwrap_or(1.0),
            None => 1.0,
        };
        let factor = object.numbers::<3>("emissiveFactor")?.unwrap_or([0.0; 3]);
        let emissive = factor.map(|value| ((value * strength) as f32).clamp(0.0, f32::MAX));
        material.emissive = Vec3::from_array(emissive);
        // A texture that is multiplied by zero need not be decoded.
        if let (true, Some(texture)) = (material.emissive != Vec3::ZERO, object.object("emissiveTexture")?) {
            let (texture, uv) = self.textures.request(resources, &texture)?;
            material.emissive_texture = texture;
            material_use.emissive_uv = texture.map(|_| uv);
            if texture.is_none() {
                material.emissive = Vec3::ZERO;
            }
        }
        Ok(())
    }

    /// All materials, and the textures that could be decoded.
    pub(super) fn finish(
        mut self,
        resources: &Resources<'_>,
    ) -> Result<(Vec<Material>, Vec<Texture>), ImportError> {
        let mut textures = Vec::new();
        let mut places = Vec::new();
        for texture in self.textures.decode(resources)? {
            places.push(texture.is_some().then_some(textures.len() as u32));
            textures.extend(texture);
        }
        for material in &mut self.materials {
            material.base_color_texture =
                material.base_color_texture.and_then(|index| places[index as usize]);
            if let Some(index) = material.emissive_texture {
                material.emissive_texture = places[index as usize];
                if material.emissive_texture.is_none() {
                    material.emissive = Vec3::ZERO;
                }
            }
        }
        Ok((self.materials, textures))
    }
}

type Color<'a> = ([f64; 4], Option<Json<'a>>);

/// Factor and texture of the base colour; the diffuse colour where a material has nothing else.
fn base_color<'a>(resources: &Resources<'_>, material: &Json<'a>) -> Result<Option<Color<'a>>, ImportError> {
    let read = |object: &Json<'a>, factor: &str, texture: &str| {
        Ok::<_, ImportError>((object.numbers::<4>(factor)?, object.object(texture)?))
    };
    let metallic = material.object("pbrMetallicRoughness")?;
    let color = metallic.map(|object| read(&object, "baseColorFactor", "baseColorTexture")).transpose()?;
    if let Some((factor, texture)) = color
        && (factor.is_some() || texture.is_some())
    {
        return Ok(Some((factor.unwrap_or([1.0; 4]), texture)));
    }
    if let Some(glossy) = material.extension("KHR_materials_pbrSpecularGlossiness") {
        let (factor, texture) = read(&glossy, "diffuseFactor", "diffuseTexture")?;
        return Ok(Some((factor.unwrap_or([1.0; 4]), texture)));
    }
    if material.extension("KHR_techniques_webgl").is_some() {
        resources
            .warn(format!("{}: KHR_techniques_webgl is ignored; its base colour is white", material.place()));
    }
    Ok(None)
}
