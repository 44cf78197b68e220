//! Every shader compiles, and the stage table, the files, the twins and the structs agree. Needs no GPU.

use manyview_shaders::stages::{BindingKind, Kind, STAGES, Stage};
use manyview_shaders::types::GPU_STRUCTS;
use naga::valid::{Capabilities, ValidationFlags, Validator};
use naga::{AddressSpace, ImageClass, ImageDimension, ScalarKind, ShaderStage, StorageAccess, TypeInner};
use std::collections::{BTreeMap, BTreeSet};
use std::path::Path;

/// `texture_2d_array<u32>`.
const ROWS_CLASS: ImageClass = ImageClass::Sampled { kind: ScalarKind::Uint, multi: false };

fn compile(stage: &Stage) -> Result<naga::Module, String> {
    let source = stage.wgsl();
    let module = naga::front::wgsl::parse_str(&source).map_err(|e| e.emit_to_string(&source))?;
    Validator::new(ValidationFlags::all(), Capabilities::empty())
        .validate(&module)
        .map_err(|e| e.emit_to_string(&source))?;
    Ok(module)
}

fn modules() -> Vec<(&'static Stage, naga::Module)> {
    let mut failures = Vec::new();
    let mut modules = Vec::new();
    for &stage in STAGES {
        match compile(stage) {
            Ok(module) => modules.push((stage, module)),
            Err(error) => failures.push(format!("{}.wgsl: {error}", stage.name)),
        }
    }
    assert!(failures.is_empty(), "{}", failures.join("\n"));
    assert!(!modules.is_empty(), "the stage table is empty");
    modules
}

#[test]
fn every_shader_is_valid() {
    modules();
}

#[test]
fn a_broken_shader_would_be_noticed() {
    let file = ("broken", "@compute @workgroup_size(1) fn main() { let x: u32 = 1i; }");
    let stage =
        Stage { name: "broken", bindings: &[], kind: STAGES[0].kind, files: Box::leak(Box::new([file])) };
    assert!(compile(&stage).is_err());
}

#[test]
fn bindings_are_what_the_table_says() {
    for (stage, module) in modules() {
        let mut found = BTreeMap::new();
        for (_, global) in module.global_variables.iter() {
            let Some(binding) = global.binding else { continue };
            assert_eq!(binding.group, 0, "{}", stage.name);
            let kind = match (global.space, &module.types[global.ty].inner) {
                (AddressSpace::Uniform, _) => BindingKind::Uniform,
                (AddressSpace::Storage { access }, _) if access == StorageAccess::LOAD => BindingKind::Read,
                (AddressSpace::Storage { .. }, _) => BindingKind::ReadWrite,
                (_, TypeInner::Image { class: ImageClass::Depth { multi: false }, .. }) => BindingKind::Depth,
                (_, TypeInner::Image { dim: ImageDimension::D2, arrayed: true, class: ROWS_CLASS }) => {
                    BindingKind::Rows
                }
                other => panic!("{}: binding {} is {other:?}", stage.name, binding.binding),
            };
            assert!(found.insert(binding.binding, kind).is_none(), "{}", stage.name);
        }
        let expected: BTreeMap<u32, BindingKind> = (0..).zip(stage.bindings.iter().copied()).collect();
        assert_eq!(found, expected, "{}", stage.name);
        let buffers =
            stage.bindings.iter().filter(|k| matches!(k, BindingKind::Read | BindingKind::ReadWrite)).count();
        assert!(buffers <= 8, "{} exceeds WebGPU's default of 8 storage buffers", stage.name);
    }
}

#[test]
fn entry_points_are_what_the_table_says() {
    for (stage, module) in modules() {
        let found: Vec<(&str, ShaderStage, [u32; 3])> =
            module.entry_points.iter().map(|e| (e.name.as_str(), e.stage, e.workgroup_size)).collect();
        let expected = match stage.kind {
            Kind::Compute { workgroup_size, .. } => vec![("main", ShaderStage::Compute, workgroup_size)],
            Kind::Depth { .. } => {
                vec![("vertex", ShaderStage::Vertex, [0; 3]), ("fragment", ShaderStage::Fragment, [0; 3])]
            }
        };
        assert_eq!(found, expected, "{}", stage.name);
    }
}

#[test]
fn structs_are_laid_out_as_in_rust() {
    let mut seen = BTreeSet::new();
    for (stage, module) in modules() {
        // A struct that buffers hold, alone or in arrays, must be known to Rust; lists with a header and structs of
        // the shader's own functions need not.
        let mut layouter = naga::proc::Layouter::default();
        layouter.update(module.to_ctx()).expect("valid");
        for (handle, ty) in module.types.iter() {
            let (Some(name), TypeInner::Struct { members, .. }) = (&ty.name, &ty.inner) else { continue };
            let Some(known) = GPU_STRUCTS.iter().find(|s| s.name == name) else {
                let in_buffers =
                    module.global_variables.iter().any(|(_, g)| match module.types[g.ty].inner {
                        TypeInner::Array { base, .. } => base == handle,
                        _ => g.space == AddressSpace::Uniform && g.ty == handle,
                    });
                assert!(!in_buffers, "{}: `{name}` is in a buffer and not in GPU_STRUCTS", stage.name);
                continue;
            };
            let fields: Vec<(&str, usize)> = members
                .iter()
                .map(|m| (m.name.as_deref().expect("members have names"), m.offset as usize))
                .collect();
            assert_eq!(fields, known.fields, "{}: {name}", stage.name);
            assert_eq!(layouter[handle].to_stride() as usize, known.size, "{}: {name}", stage.name);
            seen.insert(known.name);
        }
    }
    let all: BTreeSet<&str> = GPU_STRUCTS.iter().map(|s| s.name).collect();
    assert_eq!(seen, all, "structs that no shader uses");
}

fn stems(folder: &str, extension: &str) -> BTreeSet<String> {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join(folder);
    std::fs::read_dir(&folder)
        .unwrap_or_else(|e| panic!("{}: {e}", folder.display()))
        .map(|entry| entry.expect("readable").path())
        .filter(|path| path.extension().is_some_and(|e| e == extension))
        .map(|path| path.file_stem().expect("a name").to_string_lossy().into_owned())
        .collect()
}

#[test]
fn table_files_and_twins_are_complete() {
    let stages: BTreeSet<String> = STAGES.iter().map(|s| s.name.to_owned()).collect();
    let used: BTreeSet<String> =
        STAGES.iter().flat_map(|s| s.files).map(|(name, _)| (*name).to_owned()).collect();
    let files = stems(".", "wgsl");
    assert_eq!(files, used, "shaders/*.wgsl and the files that the table names");
    let (libs, own): (BTreeSet<_>, BTreeSet<_>) = files.into_iter().partition(|f| f.starts_with("lib_"));
    assert!(!libs.is_empty());
    assert_eq!(own, stages, "shaders/*.wgsl and the table");
    let twins: BTreeSet<String> =
        stems("src/stages", "rs").into_iter().filter(|f| !f.starts_with("lib_")).collect();
    assert_eq!(twins, stages, "shaders/src/stages/*.rs and the table");
}
