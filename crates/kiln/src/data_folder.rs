//! Where results are kept between runs.

use crate::{args::Common, failure::Failure};
use std::path::PathBuf;

/// The folder given, or this user's default one.
pub(crate) fn data_folder(common: &Common, part: &str) -> Result<PathBuf, Failure> {
    if let Some(folder) = &common.data_dir {
        return Ok(folder.clone());
    }
    let folders = directories::ProjectDirs::from("", "", "kiln").ok_or_else(|| {
        Failure::usage("this user has no home folder to keep results in; name a folder with --data-dir")
    })?;
    Ok(folders.cache_dir().join(part))
}
