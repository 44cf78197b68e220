//! Primitives: triangles of any mode, and the attributes that the bake keeps, morph targets applied.

use super::accessor::Accessor;
use super::deform::Influences;
use super::draco::Decoded;
use super::error::ImportError;
use super::json::Json;
use super::materials::MaterialUse;
use super::resources::Resources;
use super::textures::UvUse;
use crate::scene::Mesh;
use glam::{Vec2, Vec3, Vec4};

/// Memory that a vertex and a triangle take in a [`Mesh`] at most, counted before they are made.
const VERTEX_BYTES: u64 = 56;
const TRIANGLE_BYTES: u64 = 12;

/// A primitive in object space, and what a skin needs to bend it.
#[derive(Debug)]
pub(super) struct Loaded {
    pub(super) mesh: Mesh,
    pub(super) influences: Influences,
}

/// Loads a primitive with morph weights applied; `None` if it draws no triangles.
pub(super) fn load(
    resources: &Resources<'_>,
    primitive: &Json<'_>,
    material: MaterialUse,
    weights: &[f32],
    skinned: bool,
) -> Result<Option<Loaded>, ImportError> {
    let Some(attributes) = primitive.object("attributes")? else {
        return Err(primitive.malformed_at("attributes", "is missing"));
    };
    let Some(mut source) = Attributes::open(resources, primitive, attributes, weights)? else {
        return Ok(None);
    };
    let indices = source.indices(primitive)?;
    let mut triangles = triangles(resources, primitive, &indices)?;
    drop(indices);
    if triangles.is_empty() {
        return Ok(None);
    }
    source.select_used(&mut triangles);
    let vertices = source.selected();
    resources.charge(
        vertices as u64 * VERTEX_BYTES + triangles.len() as u64 * TRIANGLE_BYTES,
        &primitive.place(),
    )?;
    let mut mesh = Mesh { triangles, material: material.index, ..Mesh::default() };
    mesh.positions = source.positions()?;
    mesh.normals = source.normals(&mesh)?;
    mesh.base_color_uvs = source.uvs(material.base_color_uv)?;
    mesh.emissive_uvs = source.uvs(material.emissive_uv)?;
    mesh.colors = source.colors()?;
    let influences = if skinned { source.influences()? } else { Influences::default() };
    Ok(Some(Loaded { mesh, influences }))
}

/// Triangles by vertex indices, counter-clockwise as the file's mode says.
fn triangles(
    resources: &Resources<'_>,
    primitive: &Json<'_>,
    indices: &Indices,
) -> Result<Vec<[u32; 3]>, ImportError> {
    let count = indices.len();
    let at = |i: usize| indices.at(i);
    let mode = primitive.index("mode")?.unwrap_or(4);
    let list_count = if mode == 4 { count / 3 } else { count.saturating_sub(2) };
    resources.charge(list_count as u64 * TRIANGLE_BYTES, &primitive.place())?;
    Ok(match mode {
        4 => {
            if !count.is_multiple_of(3) {
                resources.warn(format!(
                    "{}: {count} indices are no whole triangles; the rest is left out",
                    primitive.place()
                ));
            }
            (0..list_count).map(|i| [at(3 * i), at(3 * i + 1), at(3 * i + 2)]).collect()
        }
        5 => (0..list_count)
            .map(|i| if i % 2 == 0 { [at(i), at(i + 1), at(i + 2)] } else { [at(i), at(i + 2), at(i + 1)] })
            .collect(),
        6 => (0..list_count).map(|i| [at(i + 1), at(i + 2), at(0)]).collect(),
        0..=3 => {
            resources.warn(format!("{}: points and lines are not drawn", primitive.place()));
            Vec::new()
        }
        other => return Err(primitive.malformed_at("mode", format!("{other} is no primitive mode"))),
    })
}

/// Vertex indices, written down or just counted.
enum Indices {
    Listed(Vec<u32>),
    Counted(usize),
}

impl Indices {
    fn len(&self) -> usize {
        match self {
            Self::Listed(list) => list.len(),
            Self::Counted(count) => *count,
        }
    }

    fn at(&self, i: usize) -> u32 {
        match self {
            Self::Listed(list) => list[i],
            Self::Counted(_) => i as u32,
        }
    }
}

/// Attributes of one primitive, wherever they come from.
struct Attributes<'r, 'a> {
    resources: &'r Resources<'a>,
    attributes: Json<'a>,
    targets: Vec<(Json<'a>, f32)>,
    draco: Option<(Decoded, Json<'a>)>,
    vertex_count: usize,
    /// Vertices that triangles use, ascending, if these are not all.
    used: Option<Vec<u32>>,
}

impl<'r, 'a> Attributes<'r, 'a> {
    /// Opens the attributes of a primitive; `None` if it has no positions.
    fn open(
        resources: &'r Resources<'a>,
        primitive: &Json<'a>,
        attributes: Json<'a>,
        weights: &[f32],
    ) -> Result<Option<Self>, ImportError> {
        let Some(position) = attributes.reference("POSITION", &resources.root, "accessors")? else {
            resources.warn(format!("{}: has no positions, so nothing is drawn", primitive.place()));
            return Ok(None);
        };
        let position = Accessor::parse(resources, position)?;
        let draco = match primitive.extension("KHR_draco_mesh_compression") {
            None => None,
            Some(extension) => {
                let ids = extension.object("attributes")?;
                let ids = ids.ok_or_else(|| extension.malformed_at("attributes", "is missing"))?;
                Some((Decoded::decode(resources, &extension)?, ids))
            }
        };
        if draco.is_none() {
            position.check_extent(resources)?;
        }
        let vertex_count = draco.as_ref().map_or(position.count, |(draco, _)| draco.vertex_count);
        let targets = primitive.items("targets")?.into_iter().zip(weights.iter().copied());
        let targets = targets.filter(|(_, weight)| *weight != 0.0).collect();
        Ok(Some(Self { resources, attributes, targets, draco, vertex_count, used: None }))
    }

    fn indices(&self, primitive: &Json<'a>) -> Result<Indices, ImportError> {
        let (indices, place) = if let Some((draco, _)) = &self.draco {
            (draco.indices(), primitive.place())
        } else if let Some(index) = primitive.reference("indices", &self.resources.root, "accessors")? {
            let accessor = Accessor::parse(self.resources, index)?;
            let place = primitive.place_of("indices");
            (accessor.read_indices(self.resources, &place)?, format!("{place} ({})", accessor.place()))
        } else {
            return Ok(Indices::Counted(self.vertex_count));
        };
        if let Some(at) = indices.iter().position(|index| *index as usize >= self.vertex_count) {
            return Err(ImportError::Malformed {
                file: self.resources.root.file().to_owned(),
                place,
                rule: format!(
                    "element {at} is {}, but there are {} vertices",
                    indices[at], self.vertex_count
                ),
            });
        }
        Ok(Indices::Listed(indices))
    }

    /// Drops vertices that no triangle uses: exporters let many primitives share one large array.
    fn select_used(&mut self, triangles: &mut [[u32; 3]]) {
        let corners = triangles.as_flattened();
        let mut used: Vec<u32>;
        if corners.len() < self.vertex_count / 8 {
            used = corners.to_vec();
            used.sort_unstable();
            used.dedup();
        } else {
            let mut marks = vec![false; self.vertex_count];
            corners.iter().for_each(|corner| marks[*corner as usize] = true);
            used = (0..self.vertex_count as u32).filter(|vertex| marks[*vertex as usize]).collect();
        }
        if used.len() == self.vertex_count {
            return;
        }
        for corner in triangles.as_flattened_mut() {
            *corner = used.partition_point(|vertex| *vertex < *corner) as u32;
        }
        self.used = Some(used);
    }

    fn selected(&self) -> usize {
        self.used.as_ref().map_or(self.vertex_count, Vec::len)
    }

    /// Number in the file of the selected vertex `at`.
    fn vertex(&self, at: usize) -> usize {
        self.used.as_ref().map_or(at, |used| used[at] as usize)
    }

    /// A complaint about vertex `at` of an attribute.
    fn malformed(&self, name: &str, at: usize, rule: String) -> ImportError {
        let accessor = self.attributes.index(name).ok().flatten();
        let accessor = accessor.map_or(String::new(), |index| format!(" (accessors[{index}])"));
        ImportError::Malformed {
            file: self.resources.root.file().to_owned(),
            place: format!("{}{accessor} element {}", self.attributes.place_of(name), self.vertex(at)),
            rule,
        }
    }

    /// Numbers of the attribute `name` and how many a vertex has, morph targets added; `None` if it is missing.
    fn read(&self, name: &str, widths: &[usize]) -> Result<Option<(Vec<f32>, usize)>, ImportError> {
        let Some(index) = self.attributes.reference(name, &self.resources.root, "accessors")? else {
            return Ok(None);
        };
        let mut accessor = Accessor::parse(self.resources, index)?;
        let place = self.attributes.place_of(name);
        if !widths.contains(&accessor.width) {
            return Err(accessor
                .malformed(format!("has {} components, of which {place} cannot be made", accessor.width)));
        }
        // Some exporters forget to say so; a colour of integers cannot be anything else.
        accessor.normalized |= name == "COLOR_0";
        let width = accessor.width;
        let mut values = match self.read_draco(name, &accessor)? {
            Some(values) => values,
            None => self.read_accessor(&accessor, &place)?,
        };
        for (target, weight) in &self.targets {
            let Some(index) = target.reference(name, &self.resources.root, "accessors")? else { continue };
            let accessor = Accessor::parse(self.resources, index)?;
            let place = target.place_of(name);
            // Tangents lose their handedness in morph targets, so a narrower target is right for some attributes.
            if accessor.width > width {
                return Err(
                    accessor.malformed(format!("has {} components, too many for {place}", accessor.width))
                );
            }
            let deltas = self.read_accessor(&accessor, &place)?;
            for (value, delta) in values.chunks_exact_mut(width).zip(deltas.chunks_exact(accessor.width)) {
                value.iter_mut().zip(delta).for_each(|(value, delta)| *value += weight * delta);
            }
        }
        Ok(Some((values, width)))
    }

    fn read_accessor(&self, accessor: &Accessor<'a>, place: &str) -> Result<Vec<f32>, ImportError> {
        if accessor.count != self.vertex_count {
            return Err(accessor.malformed(format!(
                "has {} elements as {place}, but the primitive has {} vertices",
                accessor.count, self.vertex_count
            )));
        }
        accessor.read(self.resources, self.used.as_deref(), place)
    }

    fn read_draco(&self, name: &str, accessor: &Accessor<'a>) -> Result<Option<Vec<f32>>, ImportError> {
        let Some((draco, ids)) = &self.draco else { return Ok(None) };
        let Some(id) = ids.index(name)? else { return Ok(None) };
        let values = u32::try_from(id).ok().and_then(|id| draco.read(id, accessor.width));
        let values =
            values.ok_or_else(|| ids.malformed_at(name, format!("the Draco data has no attribute {id}")))?;
        let mut values = match &self.used {
            None => values,
            Some(used) => used
                .iter()
                .flat_map(|vertex| &values[*vertex as usize * accessor.width..][..accessor.width])
                .copied()
                .collect(),
        };
        if accessor.normalized {
            values.iter_mut().for_each(|value| *value = (*value * accessor.component.unit()).max(-1.0));
        }
        Ok(Some(values))
    }

    fn positions(&self) -> Result<Vec<Vec3>, ImportError> {
        let Some((values, _)) = self.read("POSITION", &[3])? else { return Ok(Vec::new()) };
        let positions: Vec<Vec3> =
            values.as_chunks::<3>().0.iter().map(|value| Vec3::from_array(*value)).collect();
        if let Some(at) = positions.iter().position(|position| !position.is_finite()) {
            let p = positions[at];
            return Err(self.malformed("POSITION", at, format!("({}, {}, {}) is not finite", p.x, p.y, p.z)));
        }
        Ok(positions)
    }

    fn normals(&self, mesh: &Mesh) -> Result<Vec<Vec3>, ImportError> {
        let Some((values, _)) = self.read("NORMAL", &[3])? else { return Ok(Vec::new()) };
        let unit = |value: &[f32; 3]| unit_or_zero(Vec3::from_array(*value));
        let mut normals: Vec<Vec3> = values.as_chunks::<3>().0.iter().map(unit).collect();
        repair_normals(&mut normals, mesh);
        Ok(normals)
    }

    fn uvs(&self, uv_use: Option<UvUse>) -> Result<Vec<Vec2>, ImportError> {
        let Some(uv_use) = uv_use else { return Ok(Vec::new()) };
        let name = format!("TEXCOORD_{}", uv_use.set);
        let Some((values, _)) = self.read(&name, &[2])? else {
            self.resources
                .warn(format!("{}: is missing, so its texture is not used", self.attributes.place_of(&name)));
            return Ok(Vec::new());
        };
        let uvs: Vec<Vec2> = values.as_chunks::<2>().0.iter().map(|uv| uv_use.apply(*uv)).collect();
        if let Some(at) = uvs.iter().position(|uv| !uv.is_finite()) {
            return Err(self.malformed(&name, at, "is not finite".to_owned()));
        }
        Ok(uvs)
    }

    fn colors(&self) -> Result<Vec<Vec4>, ImportError> {
        let Some((values, width)) = self.read("COLOR_0", &[3, 4])? else { return Ok(Vec::new()) };
        let color =
            |color: &[f32]| Vec4::new(color[0], color[1], color[2], color.get(3).copied().unwrap_or(1.0));
        let colors: Vec<Vec4> = values.chunks_exact(width).map(color).collect();
        if let Some(at) = colors.iter().position(|color| !color.is_finite()) {
            return Err(self.malformed("COLOR_0", at, "is not finite".to_owned()));
        }
        Ok(colors.into_iter().map(|color| color.clamp(Vec4::ZERO, Vec4::ONE)).collect())
    }

    /// Joints and weights of all sets, four a vertex and set.
    fn influences(&self) -> Result<Influences, ImportError> {
        let mut influences = Influences::default();
        for set in 0.. {
            let (joints, weights) = (format!("JOINTS_{set}"), format!("WEIGHTS_{set}"));
            let (Some((joints, _)), Some((weights, _))) =
                (self.read(&joints, &[4])?, self.read(&weights, &[4])?)
            else {
                break;
            };
            influences.push_set(&joints, &weights);
        }
        Ok(influences)
    }
}

/// The vector at length 1, or zero where it has no direction.
pub(super) fn unit_or_zero(vector: Vec3) -> Vec3 {
    // In f64, neither tiny nor huge vectors lose their length.
    let vector = vector.as_dvec3();
    let length = vector.length();
    if length > 0.0 && length.is_finite() { (vector / length).as_vec3() } else { Vec3::ZERO }
}

/// Gives vertices whose normal is zero that of the triangles around them.
pub(super) fn repair_normals(normals: &mut [Vec3], mesh: &Mesh) {
    let broken: Vec<bool> = normals.iter().map(|normal| *normal == Vec3::ZERO).collect();
    if !broken.contains(&true) {
        return;
    }
    let mut sums = vec![glam::DVec3::ZERO; normals.len()];
    for triangle in &mesh.triangles {
        if triangle.iter().any(|corner| broken[*corner as usize]) {
            let [a, b, c] = triangle.map(|corner| mesh.positions[corner as usize].as_dvec3());
            let area = (b - a).cross(c - a);
            triangle.iter().for_each(|corner| sums[*corner as usize] += area);
        }
    }
    for ((normal, sum), _) in normals.iter_mut().zip(sums).zip(broken).filter(|(_, broken)| *broken) {
        let length = sum.length();
        *normal = if length > 0.0 && length.is_finite() { (sum / length).as_vec3() } else { Vec3::Y };
    }
}
