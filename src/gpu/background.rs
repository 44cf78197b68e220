//! Refining a scene on a thread of its own.

use std::io;
use std::sync::Arc;
use std::thread::{Builder, JoinHandle};

use super::scene::{GpuScene, Progress, StreamError};

/// A thread that refines a scene. Dropping it cancels the scene's streaming and waits for the thread.
#[derive(Debug)]
pub struct BackgroundRefinement {
    scene: Arc<GpuScene>,
    thread: Option<JoinHandle<Result<Progress, StreamError>>>,
}

impl GpuScene {
    /// Refines the scene on a new thread until all has arrived. [`GpuScene::progress`] tells how far it is; only where no
    /// thread can be started is there an error here.
    pub fn refine_in_background(self: &Arc<Self>) -> io::Result<BackgroundRefinement> {
        let scene = Arc::clone(self);
        let thread = Builder::new().name("refine scene".to_owned()).spawn(move || scene.finish())?;
        Ok(BackgroundRefinement { scene: Arc::clone(self), thread: Some(thread) })
    }
}

impl BackgroundRefinement {
    /// Whether [`join`](Self::join) would return at once.
    pub fn is_finished(&self) -> bool {
        self.thread.as_ref().is_none_or(JoinHandle::is_finished)
    }

    /// Waits until all has arrived, or for the reason why it has not.
    pub fn join(mut self) -> Result<Progress, StreamError> {
        match self.thread.take().map(JoinHandle::join) {
            Some(Ok(result)) => result,
            // A panic of the thread goes on here.
            Some(Err(panic)) => std::panic::resume_unwind(panic),
            None => Ok(self.scene.progress()),
        }
    }
}

impl Drop for BackgroundRefinement {
    fn drop(&mut self) {
        if let Some(thread) = self.thread.take() {
            self.scene.cancel();
            // Its result is of no interest to anybody.
            let _ = thread.join();
        }
    }
}
