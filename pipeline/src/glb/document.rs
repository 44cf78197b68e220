//! The JSON of a `.glb`, and which bytes its buffer views stand for.

use glam::{DMat4, Vec3};
use image::ImageEncoder;
use image::codecs::png::{CompressionType, FilterType, PngEncoder};

use super::schema::{
    Accessor, Attributes, Buffer, BufferView, EmissiveStrength, Image, Light, Lights, MaterialEntry,
    MaterialExtensions, MeshEntry, MetallicRoughness, Node, NodeExtensions, NodeLight, Primitive, Root,
    RootExtensions, Sampler, Spot, TextureEntry, TextureInfo,
};
use super::{GlbError, color_in_bytes};
use crate::scene::{AlphaMode, LightKind, Material, Mesh, PunctualLight, Scene, Texture, Wrap};

/// Component types of accessors, with glTF's numbers.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Component {
    U8 = 5121,
    U16 = 5123,
    U32 = 5125,
    F32 = 5126,
}

/// Contents of a buffer view; numbers are indices into the scene's meshes.
#[derive(Debug)]
pub(super) enum Payload {
    Positions(usize),
    Normals(usize),
    BaseColorUvs(usize),
    EmissiveUvs(usize),
    Colors(usize, Component),
    Indices(usize, Component),
    Png(Vec<u8>),
}

/// The JSON and what goes into the binary chunk.
pub(super) struct Document {
    pub(super) root: Root,
    /// One a buffer view, in order; each starts at a multiple of 4 bytes.
    pub(super) payloads: Vec<Payload>,
    /// Bytes of the binary chunk.
    pub(super) binary_length: u64,
}

/// `bufferView.target` of vertex attributes.
const ARRAY_BUFFER: u32 = 34962;
/// `bufferView.target` of indices.
const ELEMENT_ARRAY_BUFFER: u32 = 34963;

impl Document {
    /// Lays out the whole file.
    pub(super) fn new(scene: &Scene) -> Result<Self, GlbError> {
        let mut document = Self { root: Root::default(), payloads: Vec::new(), binary_length: 0 };
        let mut mesh_of = Vec::with_capacity(scene.meshes.len());
        for (index, mesh) in scene.meshes.iter().enumerate() {
            mesh_of.push((!mesh.triangles.is_empty()).then_some(document.root.meshes.len() as u32));
            if !mesh.triangles.is_empty() {
                document.add_mesh(index, mesh);
            }
        }
        for instance in &scene.instances {
            if let Some(mesh) = mesh_of[instance.mesh as usize] {
                let matrix = instance.world_from_object;
                let matrix = (matrix != DMat4::IDENTITY).then(|| matrix.to_cols_array());
                document.root.nodes.push(Node { mesh: Some(mesh), matrix, ..Node::default() });
            }
        }
        for material in &scene.materials {
            document.add_material(material);
        }
        for (index, texture) in scene.textures.iter().enumerate() {
            document.add_texture(index, texture)?;
        }
        document.add_lights(&scene.lights);
        document.root.scenes[0].nodes = (0..document.root.nodes.len() as u32).collect();
        if document.binary_length > 0 {
            document.root.buffers.push(Buffer { byte_length: document.binary_length });
        }
        Ok(document)
    }

    fn add_view(&mut self, payload: Payload, byte_length: u64, target: Option<u32>) -> u32 {
        let view = BufferView { buffer: 0, byte_offset: self.binary_length, byte_length, target };
        self.root.buffer_views.push(view);
        self.payloads.push(payload);
        self.binary_length += byte_length.next_multiple_of(4);
        self.root.buffer_views.len() as u32 - 1
    }

    fn add_accessor(
        &mut self,
        payload: Payload,
        kind: &'static str,
        component: Component,
        count: usize,
    ) -> u32 {
        let components = match kind {
            "SCALAR" => 1,
            "VEC2" => 2,
            "VEC3" => 3,
            _ => 4,
        };
        let component_bytes = match component {
            Component::U8 => 1,
            Component::U16 => 2,
            Component::U32 | Component::F32 => 4,
        };
        let count = count as u64;
        let target = if kind == "SCALAR" { ELEMENT_ARRAY_BUFFER } else { ARRAY_BUFFER };
        let buffer_view = self.add_view(payload, count * components * component_bytes, Some(target));
        self.root.accessors.push(Accessor {
            buffer_view,
            component_type: component as u32,
            normalized: component == Component::U8,
            count,
            kind,
            min: None,
            max: None,
        });
        self.root.accessors.len() as u32 - 1
    }

    fn add_mesh(&mut self, index: usize, mesh: &Mesh) {
        use Component::{F32, U8, U16, U32};
        let count = mesh.positions.len();
        let position = self.add_accessor(Payload::Positions(index), "VEC3", F32, count);
        let widen = |p: Vec3| p.as_dvec3().to_array();
        let accessor = &mut self.root.accessors[position as usize];
        accessor.min = mesh.positions.iter().copied().reduce(Vec3::min).map(widen);
        accessor.max = mesh.positions.iter().copied().reduce(Vec3::max).map(widen);
        let normal = (!mesh.normals.is_empty())
            .then(|| self.add_accessor(Payload::Normals(index), "VEC3", F32, count));
        // A second set comes only with a first one: numbers of sets have no gaps.
        let first = if mesh.base_color_uvs.is_empty() {
            (!mesh.emissive_uvs.is_empty()).then_some(Payload::EmissiveUvs(index))
        } else {
            Some(Payload::BaseColorUvs(index))
        };
        let texcoord_0 = first.map(|payload| self.add_accessor(payload, "VEC2", F32, count));
        let texcoord_1 = match (mesh.base_color_uvs.is_empty(), mesh.emissive_uvs.is_empty()) {
            (_, true) => None,
            // Materials are shared, so set 1 is what they name whether or not the sets are equal.
            (true, false) => texcoord_0,
            (false, false) => Some(self.add_accessor(Payload::EmissiveUvs(index), "VEC2", F32, count)),
        };
        let color_0 = (!mesh.colors.is_empty()).then(|| {
            let exact = mesh.colors.iter().all(|color| color_in_bytes(*color).is_some());
            let component = if exact { U8 } else { F32 };
            self.add_accessor(Payload::Colors(index, component), "VEC4", component, count)
        });
        // The largest 16-bit index is reserved for restarts.
        let component = if count <= usize::from(u16::MAX) { U16 } else { U32 };
        let indices = self.add_accessor(
            Payload::Indices(index, component),
            "SCALAR",
            component,
            mesh.triangles.len() * 3,
        );
        let attributes = Attributes { position, normal, texcoord_0, texcoord_1, color_0 };
        let primitives = [Primitive { attributes, indices, material: mesh.material }];
        self.root.meshes.push(MeshEntry { name: mesh.name.clone(), primitives });
    }

    fn add_material(&mut self, material: &Material) {
        let peak = material.emissive.max_element();
        let strength = peak.max(1.0);
        let factor = (material.emissive / strength).as_dvec3().to_array();
        let extensions = (strength > 1.0).then(|| {
            self.root.extensions_used.insert("KHR_materials_emissive_strength");
            MaterialExtensions {
                emissive_strength: EmissiveStrength { emissive_strength: f64::from(strength) },
            }
        });
        self.root.materials.push(MaterialEntry {
            name: material.name.clone(),
            pbr_metallic_roughness: MetallicRoughness {
                base_color_factor: material.base_color.to_array().map(f64::from),
                base_color_texture: material
                    .base_color_texture
                    .map(|index| TextureInfo { index, tex_coord: None }),
                metallic_factor: 0.0,
            },
            emissive_factor: (peak > 0.0).then_some(factor),
            emissive_texture: material
                .emissive_texture
                .map(|index| TextureInfo { index, tex_coord: Some(1) }),
            alpha_mode: match material.alpha_mode {
                AlphaMode::Opaque => None,
                AlphaMode::Mask { .. } => Some("MASK"),
                AlphaMode::Blend => Some("BLEND"),
            },
            alpha_cutoff: match material.alpha_mode {
                AlphaMode::Mask { cutoff } => Some(f64::from(cutoff)),
                _ => None,
            },
            double_sided: material.double_sided,
            extensions,
        });
    }

    fn add_texture(&mut self, index: usize, texture: &Texture) -> Result<(), GlbError> {
        let mut png = Vec::new();
        PngEncoder::new_with_quality(&mut png, CompressionType::Default, FilterType::Adaptive)
            .write_image(
                bytemuck::cast_slice(&texture.texels),
                texture.width,
                texture.height,
                image::ExtendedColorType::Rgba8,
            )
            .map_err(|source| GlbError::Texture { texture: index, source })?;
        let byte_length = png.len() as u64;
        let buffer_view = self.add_view(Payload::Png(png), byte_length, None);
        let [wrap_s, wrap_t] = texture.wrap.map(|wrap| match wrap {
            Wrap::Repeat => 10497,
            Wrap::MirroredRepeat => 33648,
            Wrap::ClampToEdge => 33071,
        });
        let sampler = Sampler { wrap_s, wrap_t };
        let sampler_index = self.root.samplers.iter().position(|s| *s == sampler).unwrap_or_else(|| {
            self.root.samplers.push(sampler);
            self.root.samplers.len() - 1
        });
        let source = self.root.images.len() as u32;
        self.root.images.push(Image { buffer_view, mime_type: "image/png" });
        self.root.textures.push(TextureEntry { sampler: sampler_index as u32, source });
        Ok(())
    }

    fn add_lights(&mut self, lights: &[PunctualLight]) {
        if lights.is_empty() {
            return;
        }
        self.root.extensions_used.insert("KHR_lights_punctual");
        let mut entries = Vec::with_capacity(lights.len());
        for (index, light) in lights.iter().enumerate() {
            let intensity = light.intensity.max_element().max(0.0);
            let color = if intensity > 0.0 { light.intensity / intensity } else { Vec3::ZERO };
            let (kind, spot) = match light.kind {
                LightKind::Directional => ("directional", None),
                LightKind::Point => ("point", None),
                LightKind::Spot { inner_angle, outer_angle } => {
                    let [inner_cone_angle, outer_cone_angle] = [inner_angle, outer_angle].map(f64::from);
                    ("spot", Some(Spot { inner_cone_angle, outer_cone_angle }))
                }
            };
            let is_point = light.kind == LightKind::Point;
            let is_directional = light.kind == LightKind::Directional;
            entries.push(Light {
                kind,
                color: color.as_dvec3().to_array(),
                intensity: f64::from(intensity),
                range: (light.range.is_finite() && !is_directional).then(|| f64::from(light.range)),
                spot,
            });
            let lights_punctual = NodeLight { light: index as u32 };
            self.root.nodes.push(Node {
                translation: (!is_directional).then(|| light.position.as_dvec3().to_array()),
                rotation: (!is_point).then(|| rotation_from_minus_z(light.direction)),
                extensions: Some(NodeExtensions { lights_punctual }),
                ..Node::default()
            });
        }
        self.root.extensions = Some(RootExtensions { lights_punctual: Lights { lights: entries } });
    }
}

/// The shortest rotation, as a quaternion (x, y, z, w), that takes −Z, along which lights shine, to `direction`.
fn rotation_from_minus_z(direction: Vec3) -> [f64; 4] {
    let d = direction.as_dvec3().normalize_or(glam::DVec3::NEG_Z);
    // (−Z) × d and 1 + (−Z)·d, normalized.
    let (x, y, w) = (d.y, -d.x, 1.0 - d.z);
    let length = (x * x + y * y + w * w).sqrt();
    // Half a turn about Y where the two are opposite.
    if length < 1.0e-9 { [0.0, 1.0, 0.0, 0.0] } else { [x / length, y / length, 0.0, w / length] }
}
