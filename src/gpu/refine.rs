//! Refining a scene: decoding and uploading what is left, a piece at a time.

use std::sync::atomic::Ordering;
use std::sync::{MutexGuard, PoisonError};

use manyview_shaders::device::DeviceError;
use manyview_shaders::svo_nodes::SvoNode;

use super::scene::{GpuScene, Progress, StreamError};
use super::stream::{Refinement, Step};

impl GpuScene {
    /// Goes on for at most `max_bytes` or a chunk a thread, but at least for one chunk, unless too much is under way to
    /// the GPU already. Decodes on the threads of the current rayon pool, and never waits for the GPU. After an error of the archive what has arrived
    /// stays usable, and the next call tries again.
    pub fn poll(&self, max_bytes: u64) -> Result<Progress, StreamError> {
        self.go_on(&mut self.lock(), max_bytes)
    }

    /// Goes on until all has arrived on the GPU. Waits.
    pub fn finish(&self) -> Result<Progress, StreamError> {
        self.drive(|progress| progress.is_complete)?;
        self.wait()?;
        Ok(self.progress())
    }

    /// Waits until what was uploaded so far has arrived on the GPU, or for the reason why it has not.
    pub fn wait(&self) -> Result<(), StreamError> {
        loop {
            let pending = {
                let refinement = &mut *self.lock();
                let collected = self.context.pump().and_then(|()| refinement.ring.collect(&self.context));
                if let Err(error) = collected {
                    refinement.failure.get_or_insert(error.to_string());
                    return Err(error.into());
                }
                refinement.ring.pending()
            };
            match pending {
                Some(submission) => self.context.wait(&submission)?,
                None => return Ok(()),
            }
        }
    }

    /// Ends streaming: [`poll`](Self::poll) and [`finish`](Self::finish), also those under way on other threads, return
    /// [`StreamError::Cancelled`]. The scene stays as it is.
    pub fn cancel(&self) {
        self.cancelled.store(true, Ordering::Relaxed);
    }

    /// How far streaming is. Waits while another thread is in [`poll`](Self::poll).
    pub fn progress(&self) -> Progress {
        self.progress_of(&self.lock())
    }

    fn lock(&self) -> MutexGuard<'_, Refinement> {
        self.refinement.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Polls until `reached`, waiting for the GPU where nothing else is to be done.
    pub(super) fn drive(&self, reached: impl Fn(&Progress) -> bool) -> Result<(), StreamError> {
        loop {
            let (progress, pending) = {
                let mut refinement = self.lock();
                let progress = self.go_on(&mut refinement, u64::MAX)?;
                let is_full = refinement.ring.collect(&self.context)? == 0;
                (progress, refinement.ring.pending().filter(|_| is_full))
            };
            if reached(&progress) {
                return Ok(());
            }
            if let Some(submission) = pending {
                self.context.wait(&submission)?;
            }
        }
    }

    fn go_on(&self, refinement: &mut Refinement, max_bytes: u64) -> Result<Progress, StreamError> {
        if self.cancelled.load(Ordering::Relaxed) {
            return Err(StreamError::Cancelled);
        }
        let result = self.try_go_on(refinement, max_bytes);
        if let Err(StreamError::Device(error)) = &result {
            // What was under way is lost, so that nobody may take the scene for complete.
            refinement.failure.get_or_insert(error.to_string());
        }
        result
    }

    fn try_go_on(&self, refinement: &mut Refinement, max_bytes: u64) -> Result<Progress, StreamError> {
        if let Some(failure) = &refinement.failure {
            return Err(DeviceError::Failed(format!("streaming ended earlier: {failure}")).into());
        }
        self.context.pump()?;
        let free = refinement.ring.collect(&self.context)?;
        let threads = rayon::current_num_threads().max(1);
        let unit_bytes = refinement.decoded.front().map_or(1, |decoded| decoded.rows.len() as u64 * 4).max(1);
        let most =
            usize::try_from(max_bytes / unit_bytes).unwrap_or(usize::MAX).max(1).min(free).min(threads);
        if refinement.decoded.is_empty()
            && free > 0
            && let Some(&Step::Octree(level)) = refinement.steps.front()
        {
            self.load_octree_level(refinement, level)?;
            return Ok(self.progress_of(refinement));
        }
        // While rows are uploaded on this thread, the next ones are decoded on the others.
        let uploads = refinement.decoded.len().min(most);
        let wave =
            if refinement.decoded.len() == uploads { refinement.take_units(threads) } else { Vec::new() };
        let words = self.layout.words_a_direction();
        let (uploaded, decoded) =
            refinement.decode(&self.archive, words, wave, |refinement| self.upload(refinement, uploads));
        uploaded?;
        decoded?;
        Ok(self.progress_of(refinement))
    }

    fn load_octree_level(&self, refinement: &mut Refinement, level: u32) -> Result<(), StreamError> {
        let nodes = SvoNode::of_level(&self.archive.svo_level_alone(level)?);
        refinement.bytes_done += size_of_val(&nodes[..]) as u64;
        let buffer = refinement.upload_octree_level(&self.context, nodes)?;
        refinement.steps.pop_front();
        self.octree.write().unwrap_or_else(PoisonError::into_inner).push(buffer);
        Ok(())
    }

    fn upload(&self, refinement: &mut Refinement, units: usize) -> Result<(), DeviceError> {
        for _ in 0..units {
            let Some(decoded) = refinement.decoded.pop_front() else { break };
            let unit = decoded.unit.clone();
            refinement.upload_rows(&self.context, &self.rows, &self.layout, &self.kept, decoded)?;
            refinement.units_done += 1;
            refinement.bytes_done += unit.kept.len() as u64 * self.info.direction_bytes() as u64;
            let mut resident = self.resident.write().unwrap_or_else(PoisonError::into_inner);
            for &direction in &self.kept[unit.kept.clone()] {
                resident.insert(direction);
            }
            let mut changed = unit.directions;
            if refinement.units_done >= refinement.next_refresh {
                resident.refresh();
                // Directions that are not kept are looked up a last time in the end.
                refinement.next_refresh = (refinement.units_done * 2).min(refinement.all_units);
                changed = 0..self.directions.count();
            }
            let tile = |direction: &u32| self.tile_of(*direction).unwrap_or(0);
            let tiles: Vec<u32> =
                resident.nearest()[changed.start as usize..changed.end as usize].iter().map(tile).collect();
            drop(resident);
            self.context.guarded("the tile table", tiles.len() as u64 * 4, || {
                let offset = u64::from(changed.start) * 4;
                self.context.queue().write_buffer(&self.tile_table, offset, bytemuck::cast_slice(&tiles));
                self.context.queue().submit([]);
            })?;
        }
        Ok(())
    }

    fn progress_of(&self, refinement: &Refinement) -> Progress {
        let resident = self.resident.read().unwrap_or_else(PoisonError::into_inner).count();
        Progress {
            bytes_done: refinement.bytes_done,
            bytes_total: self.bytes_total,
            directions_resident: resident as u32,
            directions_kept: self.kept.len() as u32,
            octree_levels: self.octree.read().unwrap_or_else(PoisonError::into_inner).len() as u32,
            octree_levels_kept: self.octree_levels_kept,
            is_usable: refinement.units_done >= refinement.coarse_units,
            is_complete: refinement.is_done(),
        }
    }
}
