//! Compute pipelines made from WESL modules, kept in a cache.

use std::sync::Arc;

use super::Gpu;
use super::shader::{self, Fill};
use crate::{Error, Result};

/// How a kernel uses one of its bindings.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub enum Access {
    /// `var<storage, read>`.
    Read,
    /// `var<storage, read_write>`.
    ReadWrite,
    /// `var<uniform>`.
    Uniform,
}

/// What a pipeline is made from. Layouts are explicit because unused bindings vanish from the composed source.
#[derive(Debug, Clone, Copy)]
pub struct Kernel<'a> {
    /// Module path of the WESL file that holds the entry point: one of the library, or one that stands in `fills`. A
    /// kernel that is wholly a caller's own is a module of any new path below `package::` with its source in `fills`;
    /// it can import modules of the library.
    pub module: &'a str,
    /// The entry point.
    pub entry: &'a str,
    /// Bindings of `@group(0)`, numbered from 0.
    pub bindings: &'a [Access],
    /// Bindings of `@group(1)`: those of a visitor.
    pub visitor_bindings: &'a [Access],
    /// Open or new module paths and what stands there.
    pub fills: &'a [(&'a str, Fill<'a>)],
    /// Conditions for `@if`.
    pub features: &'a [(&'a str, bool)],
    /// Values of `override` constants of the root module.
    pub constants: &'a [(&'a str, f64)],
    /// Invocations of the workgroup with these constants; checked against the device.
    pub workgroup_size: u32,
}

impl<'a> Kernel<'a> {
    /// A kernel without visitor, fills, features and constants.
    pub const fn new(module: &'a str, entry: &'a str, bindings: &'a [Access], workgroup_size: u32) -> Self {
        Self {
            module,
            entry,
            bindings,
            visitor_bindings: &[],
            fills: &[],
            features: &[],
            constants: &[],
            workgroup_size,
        }
    }
}

/// A compiled kernel.
#[derive(Debug)]
pub struct Pipeline {
    pub(super) raw: wgpu::ComputePipeline,
    pub(super) groups: Vec<wgpu::BindGroupLayout>,
    name: String,
    /// Invocations of a workgroup.
    pub workgroup_size: u32,
}

impl Pipeline {
    /// Module path and entry point.
    pub fn name(&self) -> &str {
        &self.name
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
        let from_caller = is_from_caller(kernel);
        self.cached(kernel, from_caller)
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
        self.cached(kernel, false)
    }

    fn cached(&self, kernel: &Kernel<'_>, checks: bool) -> Result<Arc<Pipeline>> {
        let key = format!("{checks} {kernel:?}");
        if let Some(pipeline) = self.pipelines().get(&key) {
            return Ok(Arc::clone(pipeline));
        }
        let pipeline = Arc::new(self.compile(kernel, checks)?);
        self.pipelines().insert(key, Arc::clone(&pipeline));
        Ok(pipeline)
    }

    fn compile(&self, kernel: &Kernel<'_>, checks: bool) -> Result<Pipeline> {
        let name = format!("{}::{}", kernel.module, kernel.entry);
        // wgpu does not validate overridden workgroup sizes.
        if kernel.workgroup_size > self.limits().workgroup_invocations {
            return Err(Error::Unsupported {
                what: format!("a workgroup of {} invocations for {name}", kernel.workgroup_size),
                advice: "use the CPU or another device",
            });
        }
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
        let compiled = self.checked(&name, 0, || {
            let descriptor =
                wgpu::ShaderModuleDescriptor { label: Some(&name), source: wgpu::ShaderSource::Wgsl(source.into()) };
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
                .map(|(_, bindings)| bind_group_layout(device, &name, bindings))
                .collect();
            let layout = device.create_pipeline_layout(&wgpu::PipelineLayoutDescriptor {
                label: Some(&name),
                bind_group_layouts: &groups.iter().map(Some).collect::<Vec<_>>(),
                immediate_size: 0,
            });
            let raw = device.create_compute_pipeline(&wgpu::ComputePipelineDescriptor {
                label: Some(&name),
                layout: Some(&layout),
                module: &module,
                entry_point: Some(kernel.entry),
                compilation_options: wgpu::PipelineCompilationOptions {
                    constants: kernel.constants,
                    zero_initialize_workgroup_memory: false,
                },
                cache: None,
            });
            (raw, groups)
        });
        let (raw, groups) = compiled.map_err(|error| match error {
            Error::Device { message, .. } => Error::KernelRejected { kernel: name.clone(), message },
            other => other,
        })?;
        Ok(Pipeline { raw, groups, name, workgroup_size: kernel.workgroup_size })
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
