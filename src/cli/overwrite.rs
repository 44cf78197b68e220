//! Outputs that would overwrite an input, or each other.

use std::path::{Component, Path, PathBuf};

use manyview_pipeline::run::same_file;

use super::error::CliError;

/// A file of a command, and the option that names it.
pub(crate) type Named<'a> = (&'a str, &'a Path);

/// An error that names both options if an output is an input, or another output.
pub(crate) fn check_outputs(inputs: &[Named<'_>], outputs: &[Named<'_>]) -> Result<(), CliError> {
    for (index, &(option, path)) in outputs.iter().enumerate() {
        if let Some((other, _)) = inputs.iter().find(|(_, input)| is_same_path(path, input)) {
            return Err(CliError::usage(format!(
                "{option} {}: it would overwrite {other}, which is the same file; choose another path for {option}",
                path.display()
            )));
        }
        if let Some((other, _)) = outputs[..index].iter().find(|(_, output)| is_same_path(path, output)) {
            return Err(CliError::usage(format!(
                "{option} {}: {other} is the same file, and one would overwrite the other; choose another path",
                path.display()
            )));
        }
    }
    Ok(())
}

/// Whether two paths, of files that need not exist yet, are one.
fn is_same_path(a: &Path, b: &Path) -> bool {
    let normal = |path: &Path| path.components().filter(|c| *c != Component::CurDir).collect::<PathBuf>();
    normal(a) == normal(b) || same_file(a, b)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn both_options_are_named() {
        let (a, b) = (Path::new("a.npy"), Path::new("./a.npy"));
        let told = |inputs: &[Named<'_>], outputs: &[Named<'_>]| {
            check_outputs(inputs, outputs).err().map(|error| error.to_string()).unwrap_or_default()
        };
        assert_eq!(told(&[("--rays", a)], &[("--output", Path::new("h.npy"))]), "");
        let message = told(&[("SCENE", Path::new("s.glb")), ("--rays", a)], &[("--output", b)]);
        assert!(message.contains("--rays") && message.contains("--output ./a.npy"), "{message}");
        let message = told(&[], &[("--output", a), ("--light-bits", b)]);
        assert!(message.contains("--output") && message.contains("--light-bits"), "{message}");
    }

    #[test]
    fn a_link_is_the_file_that_it_leads_to() {
        let folder = tempfile::tempdir().unwrap();
        let at = |name: &str| folder.path().join(name);
        fs_err::create_dir(at("sub")).unwrap();
        fs_err::write(at("a"), "a").unwrap();
        assert!(is_same_path(&at("a"), &at("sub/../a")) && !is_same_path(&at("a"), &at("b")));
        #[cfg(unix)]
        {
            std::os::unix::fs::symlink(at("a"), at("link")).unwrap();
            assert!(is_same_path(&at("link"), &at("a")));
        }
    }
}
