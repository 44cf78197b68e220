//! Rows of a deforming object on the GPU against those on the CPU, bit for bit.
//!
//! Without an adapter every test is reported as ignored, or as failed if `MANYVIEW_REQUIRE_GPU` is 1.

use libtest_mimic::{Arguments, Failed, Trial};
use manyview::deform::DeformingRows;
use manyview::gpu::{AdapterChoice, GpuContext, GpuDeformingRows};
use manyview_shaders::cases::Random;
use manyview_shaders::directions::{DirectionSet, Fit};
use std::sync::{Arc, mpsc};

type Check = fn(&GpuContext) -> Result<(), Failed>;

fn main() {
    let arguments = Arguments::from_args();
    let required = std::env::var("MANYVIEW_REQUIRE_GPU").is_ok_and(|value| value == "1");
    let context =
        GpuContext::open(&AdapterChoice::from_env()).map(Arc::new).map_err(|error| error.to_string());
    let found = context.is_ok();
    let checks: [(&str, Check); 2] = [
        ("tiles_of_a_texture_are_the_rows_of_their_directions", tiles_are_rows),
        ("more_points_than_there_is_room_for_are_an_error", too_many_points),
    ];
    let trials = checks.map(|(name, check)| {
        let context = context.clone();
        Trial::test(name, move || match &context {
            Ok(context) => check(context),
            Err(reason) => Err(format!("MANYVIEW_REQUIRE_GPU is 1, but {reason}").into()),
        })
        .with_ignored_flag(!found && !required)
    });
    libtest_mimic::run(&arguments, Vec::from(trials)).exit();
}

fn points(count: usize, seed: u64) -> Vec<[i16; 3]> {
    let mut random = Random::new(seed);
    (0..count).map(|_| [(); 3].map(|()| (random.below(32_769) as i32 - 16_384) as i16)).collect()
}

fn texels(context: &GpuContext, texture: &wgpu::Texture) -> Vec<[u32; 4]> {
    let (width, height, layers) = (texture.width(), texture.height(), texture.depth_or_array_layers());
    let size = 16 * u64::from(width) * u64::from(height) * u64::from(layers);
    let buffer = context.device().create_buffer(&wgpu::BufferDescriptor {
        label: None,
        size,
        usage: wgpu::BufferUsages::COPY_DST | wgpu::BufferUsages::MAP_READ,
        mapped_at_creation: false,
    });
    let mut encoder = context.device().create_command_encoder(&wgpu::CommandEncoderDescriptor::default());
    encoder.copy_texture_to_buffer(
        texture.as_image_copy(),
        wgpu::TexelCopyBufferInfo {
            buffer: &buffer,
            layout: wgpu::TexelCopyBufferLayout {
                offset: 0,
                bytes_per_row: Some(16 * width),
                rows_per_image: Some(height),
            },
        },
        texture.size(),
    );
    context.queue().submit([encoder.finish()]);
    let (sender, receiver) = mpsc::channel();
    buffer.map_async(wgpu::MapMode::Read, .., move |result| _ = sender.send(result));
    context.device().poll(wgpu::PollType::wait_indefinitely()).unwrap();
    receiver.recv().unwrap().unwrap();
    let mapped = buffer.get_mapped_range(..).unwrap();
    let mut texels = vec![[0; 4]; size as usize / 16];
    bytemuck::cast_slice_mut(&mut texels).copy_from_slice(&mapped[..]);
    texels
}

fn tiles_are_rows(context: &GpuContext) -> Result<(), Failed> {
    // 19 directions are not a multiple of the block's step; the last two points are one pair and an odd one out.
    let directions = DirectionSet::LatLong { thetas: 19, phis: 1 };
    for (bits, count) in [(5, 1000), (6, 4097), (7, 20_000), (8, 3)] {
        let bounds = [glam::DVec3::ZERO, glam::DVec3::new(4.0, 2.0, 3.0)];
        let mut expected = DeformingRows::new(directions, bits, Fit::Extent, bounds)?;
        let rows = GpuDeformingRows::new(context, bits, expected.frames())?;
        let side = 1u32 << bits;
        let width = side << bits.saturating_sub(7);
        let texture = context.device().create_texture(&wgpu::TextureDescriptor {
            label: None,
            size: wgpu::Extent3d { width: 4 * width, height: 3 * side, depth_or_array_layers: 2 },
            mip_level_count: 1,
            sample_count: 1,
            dimension: wgpu::TextureDimension::D2,
            format: wgpu::TextureFormat::Rgba32Uint,
            usage: wgpu::TextureUsages::COPY_DST
                | wgpu::TextureUsages::COPY_SRC
                | wgpu::TextureUsages::TEXTURE_BINDING,
            view_formats: &[],
        });
        let tile = |d: u32| [d % 4 * width, d / 4 % 3 * side, d / 12];
        let buffer = GpuDeformingRows::points_buffer(context, count as u32)?;
        // The second frame must leave nothing of the first.
        for seed in [1, 2] {
            let points = points(count, seed);
            expected.refill_lattice(&points);
            rows.upload(context, &points, &buffer)?;
            let mut encoder =
                context.device().create_command_encoder(&wgpu::CommandEncoderDescriptor::default());
            rows.record_to_texture(context, &mut encoder, &buffer, &texture, &tile)?;
            context.queue().submit([encoder.finish()]);
        }
        let found = texels(context, &texture);
        let words = (side / 32) as usize;
        for (direction, rows) in (0u32..).zip(expected.rows().chunks(1 << (3 * bits - 5))) {
            let [x, y, z] = tile(direction);
            for (row, expected) in (0u32..).zip(rows.chunks(words)) {
                let texels_a_row = width / side;
                let at =
                    (((z * 3 * side) + y + row / side) * 4 * width + x + row % side * texels_a_row) as usize;
                let found = &found[at..at + texels_a_row as usize];
                if found.as_flattened()[..words] != *expected
                    || found.as_flattened()[words..].iter().any(|w| *w != 0)
                {
                    return Err(format!("{bits} bits, direction {direction}, row {row}").into());
                }
            }
        }
    }
    Ok(())
}

fn too_many_points(context: &GpuContext) -> Result<(), Failed> {
    let frames = DeformingRows::new(
        DirectionSet::Octahedral { size: 2 },
        5,
        Fit::Cube,
        [glam::DVec3::ZERO, glam::DVec3::ONE],
    )?;
    let rows = GpuDeformingRows::new(context, 5, frames.frames())?;
    let buffer = GpuDeformingRows::points_buffer(context, 10)?;
    let error = rows.upload(context, &points(11, 1), &buffer).unwrap_err().to_string();
    if !(error.contains("points") && error.contains("72")) {
        return Err(error.into());
    }
    if rows.set_point_count(context, u32::MAX).is_ok() || GpuDeformingRows::new(context, 9, &[]).is_ok() {
        return Err("absurd sizes were taken".into());
    }
    Ok(())
}
