//! Composition of WESL modules into WGSL.
//!
//! The package root is `src/`: `package::geometry::distance` is `src/geometry/distance.wesl`, the twin of the Rust
//! file beside it. A module path can be filled with another module or with a caller's source, which is how one query
//! kernel serves every structure and every visitor.

use wesl::{CompileOptions, Feature, VirtualResolver, Wesl};

use crate::{Error, Result};

/// Every WESL module of the library: path and source.
pub static MODULES: &[(&str, &str)] = &include!(concat!(env!("OUT_DIR"), "/wesl_modules.rs"));

/// What stands at a module path that a kernel leaves open.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Fill<'a> {
    /// Another module of the library, by its path.
    Module(&'a str),
    /// A caller's source. Kernels that hold it are compiled with run-time checks.
    Caller(&'a str),
}

/// Composes `root` with everything it imports into one WGSL source.
///
/// - `fills`: module paths that the library leaves open, and what stands there
/// - `features`: conditions for `@if`, all others are an error
/// - `keep_all`: keep declarations that no entry point uses, for validating a module on its own
///
/// # Errors
/// `KernelRejected` with the composer's message.
pub fn compose(root: &str, fills: &[(&str, Fill<'_>)], features: &[(&str, bool)], keep_all: bool) -> Result<String> {
    let rejected =
        |message: String| Error::KernelRejected { kernel: root.to_owned(), message: without_escapes(&message) };
    let mut resolver = VirtualResolver::new();
    for (path, source) in MODULES {
        resolver.add_module(path.parse().map_err(|e| rejected(format!("{e:?}")))?, (*source).into());
    }
    for (path, fill) in fills {
        let source = match fill {
            Fill::Module(module) => source_of(module).ok_or_else(|| rejected(format!("no module {module}")))?,
            Fill::Caller(source) => source,
        };
        resolver.add_module(path.parse().map_err(|e| rejected(format!("{e:?}")))?, source.to_owned().into());
    }
    let mut composer = Wesl::new("").set_custom_resolver(resolver);
    composer.set_options(CompileOptions { keep_root: keep_all, ..CompileOptions::default() });
    composer.use_sourcemap(true).set_missing_feature_behavior(Feature::Error);
    for (name, enabled) in features {
        composer.set_feature(name, *enabled);
    }
    let root_path = root.parse().map_err(|e| rejected(format!("{e:?}")))?;
    Ok(composer.compile(&root_path).map_err(|e| rejected(e.to_string()))?.to_string())
}

fn source_of(module: &str) -> Option<&'static str> {
    MODULES.iter().find(|(path, _)| *path == module).map(|(_, source)| *source)
}

/// The composer colours its messages; a library's errors are plain text.
fn without_escapes(text: &str) -> String {
    let mut plain = String::with_capacity(text.len());
    let mut characters = text.chars();
    while let Some(c) = characters.next() {
        if c == '\u{1b}' {
            characters.by_ref().find(|c| c.is_ascii_alphabetic());
        } else {
            plain.push(c);
        }
    }
    plain
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn escape_codes_are_removed() {
        assert_eq!(without_escapes("\u{1b}[1m\u{1b}[91merror\u{1b}[0m: x"), "error: x");
    }

    #[test]
    fn a_missing_module_is_an_error() {
        assert!(matches!(compose("package::not_there", &[], &[], false), Err(Error::KernelRejected { .. })));
    }
}
