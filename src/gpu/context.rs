use super::pipelines::Pipelines;
use manyview_shaders::device::DeviceError;
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::pin::Pin;
use std::sync::{Arc, Mutex, PoisonError};
use std::task::{Poll, Waker};
use thiserror::Error;

/// Why no GPU could be opened.
#[derive(Debug, Error)]
pub enum OpenError {
    /// There is none, or none that does.
    #[error(
        "no GPU adapter with WebGPU's default limits{wanted} was found (seen: {seen}); \
         install a Vulkan driver (Debian: mesa-vulkan-drivers) or use --backend cpu"
    )]
    NoAdapter {
        /// What else was asked for, as it goes into the message.
        wanted: String,
        /// Names of the adapters there are.
        seen: String,
    },
    /// The driver refused.
    #[error("the adapter `{adapter}` gave no device: {reason}")]
    NoDevice {
        /// Its name.
        adapter: String,
        /// What the driver says.
        reason: String,
    },
}

/// Which adapter to open.
#[derive(Debug, Clone, Default)]
pub struct AdapterChoice {
    /// Part of its name, in any case; empty means the best one.
    pub name: String,
}

impl AdapterChoice {
    /// The adapter whose name contains `MANYVIEW_ADAPTER`, if that variable is set; else the best one.
    pub fn from_env() -> Self {
        Self { name: std::env::var("MANYVIEW_ADAPTER").unwrap_or_default() }
    }
}

/// An open device with the pipelines made for it so far.
pub struct GpuContext {
    device: wgpu::Device,
    queue: wgpu::Queue,
    name: String,
    is_software: bool,
    /// What went wrong first, outside any error scope; the device is not used again.
    failure: Arc<Mutex<Option<String>>>,
    /// Errors of past work that are not known yet. Empty but in browsers, which tell of them later.
    undecided: Mutex<Vec<PendingError>>,
    pub(super) pipelines: Pipelines,
}

#[cfg(not(target_arch = "wasm32"))]
type ErrorFuture = Pin<Box<dyn Future<Output = Option<wgpu::Error>> + Send>>;
#[cfg(target_arch = "wasm32")]
type ErrorFuture = Pin<Box<dyn Future<Output = Option<wgpu::Error>>>>;

/// The error, if any, of work that is named `what` and allocates `bytes`.
struct PendingError {
    what: &'static str,
    bytes: u64,
    error: ErrorFuture,
}

impl PendingError {
    /// What went wrong, once it is known.
    fn poll(&mut self) -> Poll<Option<String>> {
        let mut context = std::task::Context::from_waker(Waker::noop());
        let Self { what, bytes, .. } = *self;
        self.error.as_mut().poll(&mut context).map(|error| {
            Some(match error? {
                wgpu::Error::OutOfMemory { .. } => format!("out of memory for {bytes} bytes of {what}"),
                other => format!("{what}: {other}"),
            })
        })
    }
}

impl std::fmt::Debug for GpuContext {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("GpuContext").field("name", &self.name).finish_non_exhaustive()
    }
}

impl GpuContext {
    /// Opens the best adapter that fits `choice`: discrete before integrated before virtual before software, and
    /// OpenGL only where nothing else does.
    pub fn open(choice: &AdapterChoice) -> Result<Self, OpenError> {
        let mut descriptor = wgpu::InstanceDescriptor::new_without_display_handle();
        descriptor.flags = wgpu::InstanceFlags::empty().with_env();
        let instance = wgpu::Instance::new(descriptor);
        let mut seen = Vec::new();
        let mut found = None;
        for backends in [wgpu::Backends::PRIMARY, wgpu::Backends::SECONDARY] {
            let adapters = pollster::block_on(instance.enumerate_adapters(backends));
            seen.extend(adapters.iter().map(|adapter| describe(&adapter.get_info())));
            found = adapters
                .into_iter()
                .filter(|adapter| {
                    describe(&adapter.get_info()).to_lowercase().contains(&choice.name.to_lowercase())
                        && wgpu::Limits::default().check_limits(&adapter.limits())
                        && adapter.get_downlevel_capabilities().is_webgpu_compliant()
                })
                .min_by_key(|adapter| rank(adapter.get_info().device_type));
            if found.is_some() {
                break;
            }
        }
        let Some(adapter) = found else {
            let wanted = match choice.name.as_str() {
                "" => String::new(),
                name => format!(" and `{name}` in its name"),
            };
            let seen = if seen.is_empty() { "none".to_owned() } else { seen.join(", ") };
            return Err(OpenError::NoAdapter { wanted, seen });
        };
        let info = adapter.get_info();
        let descriptor =
            wgpu::DeviceDescriptor { label: Some("manyview"), ..wgpu::DeviceDescriptor::default() };
        let (device, queue) = pollster::block_on(adapter.request_device(&descriptor))
            .map_err(|error| OpenError::NoDevice { adapter: info.name.clone(), reason: error.to_string() })?;
        let context = Self::from_device(device, queue);
        let failure = Arc::clone(&context.failure);
        context.device.on_uncaptured_error(Arc::new(move |error: wgpu::Error| {
            keep_first(&failure, error.to_string());
        }));
        let failure = Arc::clone(&context.failure);
        context.device.set_device_lost_callback(move |reason, message| {
            if reason != wgpu::DeviceLostReason::Destroyed {
                keep_first(&failure, format!("the device was lost: {message}"));
            }
        });
        Ok(context)
    }

    /// Uses a caller's device, which needs no more than WebGPU's default limits. The caller keeps its handlers of
    /// uncaptured errors and device loss.
    pub fn from_device(device: wgpu::Device, queue: wgpu::Queue) -> Self {
        let info = device.adapter_info();
        Self {
            device,
            queue,
            name: describe(&info),
            is_software: info.device_type == wgpu::DeviceType::Cpu,
            failure: Arc::default(),
            undecided: Mutex::default(),
            pipelines: Pipelines::default(),
        }
    }

    /// Name of the adapter, with its backend and driver.
    pub fn name(&self) -> &str {
        &self.name
    }

    /// Whether the adapter is a processor.
    pub fn is_software(&self) -> bool {
        self.is_software
    }

    /// The device.
    pub fn device(&self) -> &wgpu::Device {
        &self.device
    }

    /// Its queue.
    pub fn queue(&self) -> &wgpu::Queue {
        &self.queue
    }

    /// Runs `work`, which allocates `bytes`, and gives the first error that wgpu reports meanwhile instead of its
    /// result. `what` names it.
    pub(crate) fn guarded<R>(
        &self,
        what: &'static str,
        bytes: u64,
        work: impl FnOnce() -> R,
    ) -> Result<R, DeviceError> {
        self.check()?;
        let validation = self.device.push_error_scope(wgpu::ErrorFilter::Validation);
        let internal = self.device.push_error_scope(wgpu::ErrorFilter::Internal);
        let memory = self.device.push_error_scope(wgpu::ErrorFilter::OutOfMemory);
        let result = work();
        let errors: [ErrorFuture; 3] =
            [Box::pin(memory.pop()), Box::pin(internal.pop()), Box::pin(validation.pop())];
        let mut undecided = self.undecided.lock().unwrap_or_else(PoisonError::into_inner);
        for error in errors {
            let mut error = PendingError { what, bytes, error };
            match error.poll() {
                Poll::Ready(None) => {}
                Poll::Ready(Some(problem)) => return Err(DeviceError::Failed(problem)),
                Poll::Pending => undecided.push(error),
            }
        }
        drop(undecided);
        self.check()?;
        Ok(result)
    }

    /// Submits commands and waits until they are done.
    pub fn finish(&self, encoder: wgpu::CommandEncoder) -> Result<(), DeviceError> {
        let submission = self.guarded("commands", 0, || self.queue.submit([encoder.finish()]))?;
        self.wait(&submission)
    }

    /// Lets wgpu call back about work that is done. Never waits.
    pub(super) fn pump(&self) -> Result<(), DeviceError> {
        self.check()?;
        self.poll(wgpu::PollType::Poll)
    }

    /// Waits until a submission is done.
    pub(super) fn wait(&self, submission: &wgpu::SubmissionIndex) -> Result<(), DeviceError> {
        self.check()?;
        self.poll(wgpu::PollType::Wait { submission_index: Some(submission.clone()), timeout: None })
    }

    fn poll(&self, until: wgpu::PollType) -> Result<(), DeviceError> {
        // wgpu panics when a device is lost while it waits.
        let polled = catch_unwind(AssertUnwindSafe(|| self.device.poll(until)));
        let problem = match polled {
            Ok(Ok(_)) => return self.check(),
            Ok(Err(error)) => error.to_string(),
            Err(_) => "the device was lost while work was running".to_owned(),
        };
        keep_first(&self.failure, problem);
        self.check()
    }

    fn check(&self) -> Result<(), DeviceError> {
        self.undecided.lock().unwrap_or_else(PoisonError::into_inner).retain_mut(|error| {
            match error.poll() {
                Poll::Pending => true,
                Poll::Ready(problem) => {
                    if let Some(problem) = problem {
                        keep_first(&self.failure, problem);
                    }
                    false
                }
            }
        });
        match &*self.failure.lock().unwrap_or_else(PoisonError::into_inner) {
            Some(problem) => Err(DeviceError::Failed(format!("{problem} ({})", self.name))),
            None => Ok(()),
        }
    }
}

fn keep_first(failure: &Mutex<Option<String>>, problem: String) {
    failure.lock().unwrap_or_else(PoisonError::into_inner).get_or_insert(problem);
}

fn rank(device_type: wgpu::DeviceType) -> u32 {
    match device_type {
        wgpu::DeviceType::DiscreteGpu => 0,
        wgpu::DeviceType::IntegratedGpu => 1,
        wgpu::DeviceType::VirtualGpu => 2,
        wgpu::DeviceType::Other => 3,
        wgpu::DeviceType::Cpu => 4,
    }
}

fn describe(info: &wgpu::AdapterInfo) -> String {
    let driver = [&info.driver, &info.driver_info].map(|s| s.trim()).join(" ");
    match driver.trim() {
        "" => format!("{} ({})", info.name, info.backend),
        driver => format!("{} ({}, {driver})", info.name, info.backend),
    }
}
