//! What a pipeline is made from: a module with what fills it, conditions, constants, and how its bindings are used.

use super::shader::Fill;

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

/// A kernel that is kept until it is compiled.
#[derive(Debug)]
pub(super) struct OwnedKernel {
    module: String,
    entry: String,
    bindings: Vec<Access>,
    visitor_bindings: Vec<Access>,
    fills: Vec<(String, OwnedFill)>,
    features: Vec<(String, bool)>,
    constants: Vec<(String, f64)>,
    workgroup_size: u32,
}

#[derive(Debug)]
enum OwnedFill {
    Module(String),
    Caller(String),
}

impl From<&Kernel<'_>> for OwnedKernel {
    fn from(kernel: &Kernel<'_>) -> Self {
        let fill = |&(path, fill): &(&str, Fill<'_>)| {
            let fill = match fill {
                Fill::Module(module) => OwnedFill::Module(module.to_owned()),
                Fill::Caller(source) => OwnedFill::Caller(source.to_owned()),
            };
            (path.to_owned(), fill)
        };
        Self {
            module: kernel.module.to_owned(),
            entry: kernel.entry.to_owned(),
            bindings: kernel.bindings.to_vec(),
            visitor_bindings: kernel.visitor_bindings.to_vec(),
            fills: kernel.fills.iter().map(fill).collect(),
            features: kernel.features.iter().map(|&(name, on)| (name.to_owned(), on)).collect(),
            constants: kernel.constants.iter().map(|&(name, value)| (name.to_owned(), value)).collect(),
            workgroup_size: kernel.workgroup_size,
        }
    }
}

impl OwnedKernel {
    /// Calls `work` with the kernel as it was given.
    pub(super) fn with<R>(&self, work: impl FnOnce(&Kernel<'_>) -> R) -> R {
        let fills: Vec<_> = self.fills.iter().map(|(path, fill)| (path.as_str(), fill.borrowed())).collect();
        let features: Vec<_> = self.features.iter().map(|(name, on)| (name.as_str(), *on)).collect();
        let constants: Vec<_> = self.constants.iter().map(|(name, value)| (name.as_str(), *value)).collect();
        work(&Kernel {
            module: &self.module,
            entry: &self.entry,
            bindings: &self.bindings,
            visitor_bindings: &self.visitor_bindings,
            fills: &fills,
            features: &features,
            constants: &constants,
            workgroup_size: self.workgroup_size,
        })
    }
}

impl OwnedFill {
    fn borrowed(&self) -> Fill<'_> {
        match self {
            Self::Module(module) => Fill::Module(module),
            Self::Caller(source) => Fill::Caller(source),
        }
    }
}
