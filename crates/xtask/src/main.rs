//! Project chores: `cargo xtask tidy` and `cargo xtask licences`.

mod licences;
mod tidy;

use anyhow::{Result, bail};

fn main() -> Result<()> {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    let words: Vec<&str> = arguments.iter().map(String::as_str).collect();
    match words[..] {
        ["tidy"] => tidy::run(),
        ["licences"] => licences::run(),
        _ => bail!("chores: tidy (sizes of files and functions), licences (of every dependency)"),
    }
}
