//! Project chores; `cargo xtask` lists them.

mod generated;
mod header;
mod licences;
mod shaders;
mod tidy;

use anyhow::{Result, bail};

fn main() -> Result<()> {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    let words: Vec<&str> = arguments.iter().map(String::as_str).collect();
    match words[..] {
        ["tidy"] => tidy::run(),
        ["licences"] => licences::run(),
        ["shaders"] => shaders::run(false),
        ["shaders", "--check"] => shaders::run(true),
        ["header"] => header::run(false),
        ["header", "--check"] => header::run(true),
        _ => bail!(
            "chores: tidy (sizes of files and functions), licences (of every dependency), shaders (of kiln-runtime, from its WGSL), \
             header (of kiln-runtime, for C); the last two with --check fail where what is kept is not current"
        ),
    }
}
