//! A small town: a square with a church and a fountain, streets with lamps, houses with gardens, hills around.

use glam::{Vec3, vec2, vec3};

use super::house::{church, house};
use super::model::{Frame, Hidden, Model, place};
use super::palette::{FOLIAGE, Palette};
use super::rng::Rng;
use super::street::{bench, fountain, lamp, light_lamp};
use super::terrain::Terrain;
use super::tree::{Leaves, Spot, blades, plant};
use crate::scene::Scene;

/// Metres of a block without its streets.
const BLOCK: f32 = 44.0;
/// Metres from facade line to facade line: 6 of road, 2 of pavement on either side.
const STREET: f32 = 10.0;
const PITCH: f32 = BLOCK + STREET;
/// Metres of meadow around the town.
const OUTSKIRTS: f32 = 30.0;
/// Houses in one row of a block.
const ROW: u32 = 4;

/// What a strip of ground between two grid lines is.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
enum Strip {
    Lawn,
    Pavement,
    Road,
}

struct Town<'a> {
    scene: &'a mut Scene,
    palette: Palette,
    terrain: Terrain,
    /// Blocks along each side.
    blocks: u32,
    /// Houses are made of few triangles: a small town is to have several.
    plain: bool,
    /// Strips of ground across the outskirts, and across a block.
    strips: [u32; 2],
    rng: Rng,
}

/// Builds a town of `triangles`.
pub(super) fn town(scene: &mut Scene, triangles: u64, seed: u64) {
    let palette = Palette::new(scene);
    // About 10,000 triangles a block, of which nearly half are trees.
    let blocks = ((triangles / 10_000) as f32).sqrt().round().max(1.0) as u32;
    let terrain = Terrain::new(seed, 80.0, 7.5, 30.0);
    let plain = triangles < 20_000;
    let strips = match triangles {
        0..3_000 => [1, 2],
        3_000..20_000 => [2, 3],
        _ => [5, 8],
    };
    let mut town = Town { scene, palette, terrain, blocks, plain, strips, rng: Rng::new(seed, 1) };
    town.ground();
    town.square();
    let mut spots = town.houses(triangles / 100 * 45);
    town.lamps(triangles / 10);
    town.more_trees(&mut spots);

    let drawn = town.scene.drawn_triangles();
    let left = triangles.saturating_sub(drawn);
    // A little grass takes up the remainder of the trees too.
    let grass = left / 20;
    // Larger towns get more different trees, not only more of the same.
    let copies = 3;
    let leaves = [Leaves::Cards];
    let palette = town.palette;
    let rest = plant(town.scene, &palette, &spots, left - grass, copies, &leaves, &mut town.rng);
    town.grass(grass + rest);
}

impl Town<'_> {
    /// Metres from the centre to the outermost streets' outer edge.
    fn half_extent(&self) -> f32 {
        0.5 * (self.blocks as f32 * PITCH + STREET)
    }

    /// The square takes the place of the middle block; a hamlet has none.
    fn is_square(&self, column: u32, row: u32) -> bool {
        self.blocks >= 3 && column == self.blocks / 2 && row == self.blocks / 2
    }

    /// Centre of a block: the square's is the origin.
    fn block_centre(&self, column: u32, row: u32) -> (f32, f32) {
        let at = |i: u32| self.street(i) + 0.5 * PITCH;
        (at(column), at(row))
    }

    /// Centre line of a street, 0 to `blocks`.
    fn street(&self, index: u32) -> f32 {
        (index as f32 - (self.blocks / 2) as f32 - 0.5) * PITCH
    }

    /// Grid lines of the ground along one axis, and the strips between them.
    fn lines(&self) -> (Vec<f32>, Vec<Strip>) {
        let mut lines = vec![self.street(0) - 0.5 * STREET - OUTSKIRTS];
        let mut strips = Vec::new();
        let mut extend = |end: f32, steps: u32, strip: Strip| {
            let start = lines[lines.len() - 1];
            for step in 1..=steps {
                lines.push(start + (end - start) * (step as f32 / steps as f32));
                strips.push(strip);
            }
        };
        extend(self.street(0) - 0.5 * STREET, self.strips[0], Strip::Lawn);
        for index in 0..=self.blocks {
            let centre = self.street(index);
            extend(centre - 3.0, 1, Strip::Pavement);
            extend(centre + 3.0, 1, Strip::Road);
            extend(centre + 5.0, 1, Strip::Pavement);
            if index < self.blocks {
                extend(centre + 5.0 + BLOCK, self.strips[1], Strip::Lawn);
            }
        }
        extend(self.street(self.blocks) + 0.5 * STREET + OUTSKIRTS, self.strips[0], Strip::Lawn);
        (lines, strips)
    }

    fn ground(&mut self) {
        let (lines, strips) = self.lines();
        let mut model = Model::default();
        let pavement = self.palette.stone;
        for (row, along_z) in strips.iter().enumerate() {
            for (column, along_x) in strips.iter().enumerate() {
                let low = vec2(lines[column], lines[row]);
                let high = vec2(lines[column + 1], lines[row + 1]);
                let centre = (low + high) * 0.5;
                let in_town = centre == centre.clamp(self.corner(0), self.corner(1));
                let in_square = self.blocks >= 3 && centre.abs().max_element() < 0.5 * BLOCK;
                let strip = match (*along_x).max(*along_z) {
                    _ if in_square => Strip::Road,
                    _ if !in_town => Strip::Lawn,
                    strip => strip,
                };
                let brush = match strip {
                    Strip::Lawn => self.palette.grass,
                    Strip::Pavement => pavement,
                    Strip::Road => self.palette.cobbles,
                };
                let (corners, uvs) = self.terrain.cell(low, high, brush.repeats_per_metre.unwrap_or(0.0));
                model.quad_with_uvs(brush, corners, uvs);
            }
        }
        let meshes = model.into_scene(self.scene, "ground");
        place(self.scene, meshes, glam::DMat4::IDENTITY);
    }

    /// Corner of the streets' square: 0 the lower, 1 the upper one.
    fn corner(&self, upper: u32) -> glam::Vec2 {
        let side = if upper == 0 { -0.5 * STREET } else { 0.5 * STREET };
        glam::Vec2::splat(self.street(upper * self.blocks) + side)
    }

    fn square(&mut self) {
        if self.blocks < 3 {
            return;
        }
        let mut model = Model::default();
        church(&mut model, &self.palette, &Frame::at(vec3(-8.0, 0.0, -1.0)));
        let meshes = model.into_scene(self.scene, "church");
        place(self.scene, meshes, glam::DMat4::IDENTITY);
        let fountain_at = vec3(11.0, 0.0, 10.0);
        let meshes = fountain(&self.palette).into_scene(self.scene, "fountain");
        place(self.scene, meshes, Frame::at(fountain_at).world_from_object(1.0));
        let meshes = bench(&self.palette).into_scene(self.scene, "bench");
        for turns in 0..4 {
            let frame = Frame::quarter_turned(fountain_at, turns);
            let bench = frame.side(vec3(0.0, 0.0, 6.6), 2);
            place(self.scene, meshes.clone(), bench.world_from_object(1.0));
        }
    }

    /// Houses along two sides of every block, from the centre outwards until `budget` is spent; returns where trees
    /// of the gardens stand.
    fn houses(&mut self, budget: u64) -> Vec<Spot> {
        let mut blocks: Vec<_> =
            (0..self.blocks).flat_map(|row| (0..self.blocks).map(move |column| (column, row))).collect();
        blocks.retain(|(column, row)| !self.is_square(*column, *row));
        blocks.sort_by_key(|(column, row)| {
            let (x, z) = self.block_centre(*column, *row);
            (x * x + z * z) as u64
        });
        let mut spent = 0;
        let mut spots = Vec::new();
        for (column, row) in blocks {
            let (x, z) = self.block_centre(column, row);
            let mut model = Model::default();
            let quarter_turns = self.rng.below(2);
            let block = Frame::quarter_turned(Vec3::ZERO, quarter_turns);
            for lot in 0..2 * ROW {
                let mean = if self.plain { 150 } else { 700 };
                if spent + model.triangles() + mean > budget && spent + model.triangles() > 0 {
                    break;
                }
                let facing = if lot < ROW { 0 } else { 2 };
                let lot_width = BLOCK / ROW as f32;
                let along = ((lot % ROW) as f32 + 0.5) * lot_width - 0.5 * BLOCK;
                let row_frame = block.side(Vec3::ZERO, facing);
                let place = row_frame.moved(vec3(along, 0.0, 0.5 * BLOCK - 5.6 - self.rng.range(0.0, 2.5)));
                // On a slope the highest corner decides; the foundation reaches down to the others.
                let corners = [(-5.0, 5.0), (0.0, 5.0), (5.0, 5.0), (5.0, -5.0), (-5.0, -5.0)];
                let ground = corners.map(|(dx, dz)| {
                    let corner = place.moved(vec3(dx, 0.0, dz)).origin;
                    self.terrain.height(corner.x + x, corner.z + z)
                });
                let highest = ground.into_iter().fold(f32::MIN, f32::max) - 0.25;
                let foot = Frame { origin: place.origin + Vec3::Y * highest, ..place };
                house(&mut model, &self.palette, &foot, [lot_width - 0.6, 9.6], self.plain, &mut self.rng);
                self.hedge(&mut model, &foot, lot_width);
                for _ in 0..self.rng.below(3) {
                    let garden =
                        place.moved(vec3(self.rng.range(-4.5, 4.5), 0.0, -self.rng.range(8.0, 13.0))).origin;
                    spots.push(self.spot(garden.x + x, garden.z + z, 0.55, 0.9));
                }
            }
            spent += model.triangles();
            let meshes = model.into_scene(self.scene, &format!("block {column},{row}"));
            place(self.scene, meshes, Frame::at(vec3(x, 0.0, z)).world_from_object(1.0));
        }
        spots
    }

    /// A low hedge on one side of the house, or none.
    fn hedge(&mut self, model: &mut Model, foot: &Frame, lot_width: f32) {
        if self.rng.chance(0.5) {
            let tint = self.rng.pick(&FOLIAGE[..3]).map(|channel| channel / 2);
            let x = 0.5 * lot_width - 0.5;
            let (low, high) = (vec3(x, -1.5, -14.0), vec3(x + 0.5, self.rng.range(0.7, 1.2), -5.0));
            model.block(self.palette.leaves.tinted(tint), foot, low, high, Hidden::Bottom);
        }
    }

    fn spot(&mut self, x: f32, z: f32, low: f32, high: f32) -> Spot {
        let foot = self.terrain.point(x, z) - Vec3::Y * 0.1;
        Spot { foot, scale: self.rng.range(low, high), turn: self.rng.range(0.0, std::f32::consts::TAU) }
    }

    /// Lamps along both kinds of streets, arms over the road, as many as `budget` allows.
    fn lamps(&mut self, budget: u64) {
        let model = lamp(&self.palette);
        let cost = model.triangles();
        let meshes = model.into_scene(self.scene, "lamp");
        let mut count = (budget / cost).max(1);
        for street in 0..=self.blocks {
            for step in 0..2 * self.blocks {
                let along = self.street(0) + PITCH * (0.25 + 0.5 * step as f32) + 2.0;
                let side = if step % 2 == 0 { 3.8 } else { -3.8 };
                let across = self.street(street) + side;
                for (x, z, quarter_turns) in [(along, across, 0), (across, along, 1)] {
                    if count == 0 {
                        return;
                    }
                    count -= 1;
                    let turns = if side > 0.0 { quarter_turns + 2 } else { quarter_turns };
                    let frame = Frame::quarter_turned(self.terrain.point(x, z), turns);
                    place(self.scene, meshes.clone(), frame.world_from_object(1.0));
                    light_lamp(self.scene, &frame);
                }
            }
        }
    }

    /// Trees of the square, along the streets and in the meadows.
    fn more_trees(&mut self, spots: &mut Vec<Spot>) {
        if self.blocks >= 3 {
            for i in 0..7 {
                let along = -18.0 + 6.0 * i as f32;
                spots.push(self.spot(19.5, along, 0.7, 0.85));
                if i % 2 == 0 {
                    spots.push(self.spot(-19.0, along, 0.7, 0.85));
                }
            }
        }
        let extent = self.half_extent();
        let centre = 0.5 * (self.street(0) + self.street(self.blocks));
        for _ in 0..6 * self.blocks + 2 {
            let along = self.rng.range(-extent - OUTSKIRTS, extent + OUTSKIRTS);
            let out = (extent + self.rng.range(4.0, OUTSKIRTS - 3.0))
                * if self.rng.chance(0.5) { 1.0 } else { -1.0 };
            let (x, z) = if self.rng.chance(0.5) { (along, out) } else { (out, along) };
            let bound = extent + OUTSKIRTS - 2.0;
            let spot = self.spot(centre + x.clamp(-bound, bound), centre + z.clamp(-bound, bound), 0.9, 1.45);
            spots.push(spot);
        }
    }

    /// Blades in the meadows.
    fn grass(&mut self, count: u64) {
        let extent = self.half_extent();
        let centre = 0.5 * (self.street(0) + self.street(self.blocks));
        let terrain = self.terrain;
        let mut model = Model::default();
        blades(&mut model, &self.palette, count, &mut self.rng, |rng| {
            let along = rng.range(-extent, extent);
            let out = (extent + rng.range(0.0, OUTSKIRTS)) * if rng.chance(0.5) { 1.0 } else { -1.0 };
            let (x, z) = if rng.chance(0.5) { (along, out) } else { (out, along) };
            terrain.point(centre + x, centre + z)
        });
        let meshes = model.into_scene(self.scene, "grass");
        place(self.scene, meshes, glam::DMat4::IDENTITY);
    }
}
