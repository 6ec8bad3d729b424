//! Files that are written from others and kept in the repository.

use anyhow::{Context, Result, bail};
use std::{fs, path::Path};

/// Writes files, or, where `is_check`, fails if one is not what it would be. `command` is what writes them.
#[expect(clippy::print_stdout, reason = "this is the chore's output")]
pub(crate) fn write_or_check(files: &[(&Path, String)], is_check: bool, command: &str) -> Result<()> {
    for (path, text) in files {
        let shown = path.display();
        if !is_check {
            fs::write(path, text).with_context(|| format!("{shown} cannot be written"))?;
            println!("wrote {shown}");
        } else if fs::read_to_string(path).ok().as_ref() != Some(text) {
            bail!("{shown} is not current: run `{command}`, and commit what it writes");
        }
    }
    if is_check {
        println!("{} files are current", files.len());
    }
    Ok(())
}
