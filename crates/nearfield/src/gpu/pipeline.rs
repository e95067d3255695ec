//! Compute pipelines made from WESL modules, kept in a cache.

use std::collections::HashSet;
use std::sync::atomic::{AtomicUsize, Ordering};
use std::sync::{Arc, Mutex, OnceLock, PoisonError};

use super::Gpu;
use super::kernel::{Access, Kernel, OwnedKernel};
use super::pipeline_cache::DiskCache;
use super::shader::{self, Fill};
use crate::{Error, Result};

/// A kernel that is compiled, or will be when it is first used.
#[derive(Debug)]
pub struct Pipeline {
    compiled: OnceLock<Compiled>,
    /// Held while it is compiled.
    compiling: Mutex<()>,
    kernel: OwnedKernel,
    checks: bool,
    name: String,
    /// Invocations of a workgroup.
    pub workgroup_size: u32,
}

/// What the driver made of a kernel.
#[derive(Debug)]
pub(super) struct Compiled {
    pub(super) raw: wgpu::ComputePipeline,
    pub(super) groups: Vec<wgpu::BindGroupLayout>,
}

impl Pipeline {
    /// Module path and entry point.
    pub fn name(&self) -> &str {
        &self.name
    }

    /// What was compiled before: by [`Gpu::compile_all`], without which nothing is encoded.
    pub(super) fn ready(&self) -> &Compiled {
        self.compiled.get().expect("a pipeline should be compiled before it is encoded")
    }

    /// What was compiled, now or before.
    ///
    /// # Errors
    /// As [`Gpu::pipeline`]. The next call tries again.
    pub(super) fn compiled(&self, gpu: &Gpu) -> Result<&Compiled> {
        if let Some(compiled) = self.compiled.get() {
            return Ok(compiled);
        }
        let _compiling = self.compiling.lock().unwrap_or_else(PoisonError::into_inner);
        if let Some(compiled) = self.compiled.get() {
            return Ok(compiled);
        }
        let compiled = self.kernel.with(|kernel| gpu.compile(kernel, self.checks, &self.name))?;
        Ok(self.compiled.get_or_init(|| compiled))
    }
}

impl Gpu {
    /// The pipeline of a kernel, compiled at first use.
    ///
    /// Modules of the library are compiled without run-time checks in release builds (their indices are guarded and
    /// their loops end); with `NEARFIELD_SHADER_CHECKS=1`, in debug builds, and always where a caller's source is in
    /// the module, checks stay on.
    ///
    /// # Errors
    /// `KernelRejected` with the compiler's message; `Unsupported` if the workgroup is too large for the device.
    pub fn pipeline(&self, kernel: &Kernel<'_>) -> Result<Arc<Pipeline>> {
        self.compiled(kernel, is_from_caller(kernel))
    }

    /// As [`Gpu::pipeline`] for kernels that are wholly the library's own: they are compiled when work that uses them is first submitted, together
    /// and by several threads. Others are compiled at once.
    ///
    /// # Errors
    /// As [`Gpu::pipeline`]; errors of the compiler come from submitting.
    pub(crate) fn prepare(&self, kernel: &Kernel<'_>) -> Result<Arc<Pipeline>> {
        if is_from_caller(kernel) { self.pipeline(kernel) } else { self.cached(kernel, false) }
    }

    /// As [`Gpu::pipeline`], without run-time checks also where a caller's source is in the module. For the baselines
    /// of `nearfield-bench`, which must be compared by the same terms as the library's own kernels.
    ///
    /// # Safety
    /// Whatever the buffers bound to it hold, no invocation may index beyond the end of a buffer or an array, and every
    /// loop must end.
    ///
    /// # Errors
    /// As [`Gpu::pipeline`].
    #[doc(hidden)]
    pub unsafe fn pipeline_unchecked(&self, kernel: &Kernel<'_>) -> Result<Arc<Pipeline>> {
        self.compiled(kernel, false)
    }

    fn compiled(&self, kernel: &Kernel<'_>, checks: bool) -> Result<Arc<Pipeline>> {
        let pipeline = self.cached(kernel, checks)?;
        pipeline.compiled(self)?;
        Ok(pipeline)
    }

    fn cached(&self, kernel: &Kernel<'_>, checks: bool) -> Result<Arc<Pipeline>> {
        let key = format!("{checks} {kernel:?}");
        if let Some(pipeline) = self.pipelines().get(&key) {
            return Ok(Arc::clone(pipeline));
        }
        let name = format!("{}::{}", kernel.module, kernel.entry);
        // wgpu does not validate overridden workgroup sizes.
        if kernel.workgroup_size > self.limits().workgroup_invocations {
            return Err(Error::Unsupported {
                what: format!("a workgroup of {} invocations for {name}", kernel.workgroup_size),
                advice: "use the CPU or another device",
            });
        }
        let pipeline = Arc::new(Pipeline {
            compiled: OnceLock::new(),
            compiling: Mutex::default(),
            kernel: kernel.into(),
            checks,
            name,
            workgroup_size: kernel.workgroup_size,
        });
        Ok(Arc::clone(self.pipelines().entry(key).or_insert(pipeline)))
    }

    /// Compiles those that are not compiled yet, several at the same time.
    ///
    /// # Errors
    /// As [`Gpu::pipeline`].
    pub(super) fn compile_all<'a>(&self, pipelines: impl Iterator<Item = &'a Arc<Pipeline>>) -> Result<()> {
        let mut seen = HashSet::new();
        let missing: Vec<&Pipeline> = pipelines
            .map(Arc::as_ref)
            .filter(|pipeline| pipeline.compiled.get().is_none() && seen.insert(std::ptr::from_ref(*pipeline)))
            .collect();
        let Some((first, others)) = missing.split_first() else { return Ok(()) };
        let threads = std::thread::available_parallelism().map_or(1, std::num::NonZero::get).min(others.len() + 1);
        let next = AtomicUsize::new(0);
        let work = || {
            while let Some(pipeline) = others.get(next.fetch_add(1, Ordering::Relaxed)) {
                // An error comes again where all are looked at.
                let _ = pipeline.compiled(self);
            }
        };
        std::thread::scope(|scope| {
            for _ in 1..threads {
                // A thread that cannot be had leaves its work to the others.
                let _ = std::thread::Builder::new().spawn_scoped(scope, work);
            }
            let compiled = first.compiled(self).map(drop);
            work();
            compiled
        })?;
        missing.into_iter().try_for_each(|pipeline| pipeline.compiled(self).map(drop))
    }

    fn compile(&self, kernel: &Kernel<'_>, checks: bool, name: &str) -> Result<Compiled> {
        let source = shader::compose(kernel.module, kernel.fills, kernel.features, false)?;
        // Nor does it validate how much memory workgroups have; what a caller's code adds to it is not known before.
        let most = u64::from(self.limits().workgroup_bytes);
        if is_from_caller(kernel) && workgroup_bytes(&source) > most {
            return Err(Error::Unsupported {
                what: format!(
                    "{} bytes of workgroup memory for {name}, where the device has {most},",
                    workgroup_bytes(&source)
                ),
                advice: "use a smaller State, or a visitor without `combine`",
            });
        }
        let device = self.device();
        let compiled = self.checked(name, 0, || {
            let descriptor =
                wgpu::ShaderModuleDescriptor { label: Some(name), source: wgpu::ShaderSource::Wgsl(source.into()) };
            let module = if checks || checks_forced() {
                device.create_shader_module(descriptor)
            } else {
                // SAFETY: the source is wholly the library's own, or `pipeline_unchecked` was promised the same of it:
                // every kernel guards its indices by the lengths in its parameters, and every loop has a bound; the
                // suite runs the same kernels with checks on.
                unsafe { device.create_shader_module_trusted(descriptor, wgpu::ShaderRuntimeChecks::unchecked()) }
            };
            let groups: Vec<wgpu::BindGroupLayout> = [kernel.bindings, kernel.visitor_bindings]
                .iter()
                .enumerate()
                .filter(|(group, bindings)| *group == 0 || !bindings.is_empty())
                .map(|(_, bindings)| bind_group_layout(device, name, bindings))
                .collect();
            let layout = device.create_pipeline_layout(&wgpu::PipelineLayoutDescriptor {
                label: Some(name),
                bind_group_layouts: &groups.iter().map(Some).collect::<Vec<_>>(),
                immediate_size: 0,
            });
            let raw = device.create_compute_pipeline(&wgpu::ComputePipelineDescriptor {
                label: Some(name),
                layout: Some(&layout),
                module: &module,
                entry_point: Some(kernel.entry),
                compilation_options: wgpu::PipelineCompilationOptions {
                    constants: kernel.constants,
                    zero_initialize_workgroup_memory: false,
                },
                cache: self.disk_cache().map(DiskCache::raw),
            });
            (raw, groups)
        });
        let (raw, groups) = compiled.map_err(|error| match error {
            Error::Device { message, .. } => Error::KernelRejected { kernel: name.to_owned(), message },
            other => other,
        })?;
        if let Some(cache) = self.disk_cache() {
            cache.added();
        }
        Ok(Compiled { raw, groups })
    }
}

fn is_from_caller(kernel: &Kernel<'_>) -> bool {
    kernel.fills.iter().any(|(_, fill)| matches!(fill, Fill::Caller(_)))
}

/// Bytes of workgroup memory that a module declares; 0 of one that cannot be read, which is rejected with the reason when it is compiled.
fn workgroup_bytes(source: &str) -> u64 {
    use wgpu::naga::{AddressSpace, front::wgsl};
    let Ok(module) = wgsl::parse_str(source) else { return 0 };
    let in_workgroup = module.global_variables.iter().filter(|(_, variable)| variable.space == AddressSpace::WorkGroup);
    let size =
        |(_, variable): (_, &wgpu::naga::GlobalVariable)| module.types[variable.ty].inner.try_size(module.to_ctx());
    in_workgroup.filter_map(size).map(u64::from).sum()
}

fn checks_forced() -> bool {
    cfg!(debug_assertions) || std::env::var_os("NEARFIELD_SHADER_CHECKS").is_some_and(|v| v == "1")
}

fn bind_group_layout(device: &wgpu::Device, name: &str, bindings: &[Access]) -> wgpu::BindGroupLayout {
    let entries: Vec<_> = bindings
        .iter()
        .enumerate()
        .map(|(binding, access)| wgpu::BindGroupLayoutEntry {
            binding: binding as u32,
            visibility: wgpu::ShaderStages::COMPUTE,
            ty: wgpu::BindingType::Buffer {
                ty: match access {
                    Access::Read => wgpu::BufferBindingType::Storage { read_only: true },
                    Access::ReadWrite => wgpu::BufferBindingType::Storage { read_only: false },
                    Access::Uniform => wgpu::BufferBindingType::Uniform,
                },
                has_dynamic_offset: false,
                min_binding_size: None,
            },
            count: None,
        })
        .collect();
    device.create_bind_group_layout(&wgpu::BindGroupLayoutDescriptor { label: Some(name), entries: &entries })
}
