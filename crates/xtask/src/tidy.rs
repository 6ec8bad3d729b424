//! Sizes of files and functions: prints the outliers, and fails where the project's limits are broken.

use anyhow::{Context, Result, bail};
use std::{
    fs,
    path::{Path, PathBuf},
};

/// The median and the ninth decile that files and functions must not exceed, in lines.
const FILE_LIMITS: [usize; 2] = [200, 450];
const FUNCTION_LIMITS: [usize; 2] = [10, 40];

/// A function longer than this is listed.
const LONG_FUNCTION: usize = 70;

struct Function {
    place: String,
    lines: usize,
}

#[expect(clippy::print_stdout, reason = "this is the chore's output")]
pub(crate) fn run() -> Result<()> {
    let mut files = Vec::new();
    for folder in ["crates", "tests"] {
        collect(Path::new(folder), &mut files)?;
    }
    let (mut sizes, mut functions) = (Vec::new(), Vec::new());
    for path in &files {
        let text = fs::read_to_string(path).with_context(|| format!("{} cannot be read", path.display()))?;
        let lines = text.lines().count();
        sizes.push(lines);
        if lines > FILE_LIMITS[1] {
            println!("{lines:5} lines  {}", path.display());
        }
        functions.extend(functions_of(&text, path));
    }
    for function in functions.iter().filter(|f| f.lines > LONG_FUNCTION) {
        println!("{:5} lines  {}", function.lines, function.place);
    }
    let lengths: Vec<usize> = functions.iter().map(|f| f.lines).collect();
    let files_ok = check("files", sizes, FILE_LIMITS);
    let functions_ok = check("functions", lengths, FUNCTION_LIMITS);
    if !(files_ok && functions_ok) {
        bail!("files or functions are too long: split those listed above by what they do");
    }
    Ok(())
}

#[expect(clippy::print_stdout, reason = "this is the chore's output")]
fn check(what: &str, mut sizes: Vec<usize>, limits: [usize; 2]) -> bool {
    sizes.sort_unstable();
    let at = |fraction: f64| sizes.get((sizes.len() as f64 * fraction) as usize).copied().unwrap_or(0);
    let (median, decile) = (at(0.5), at(0.9));
    println!(
        "{} {what}: median {median} lines (limit {}), 90 % {decile} (limit {})",
        sizes.len(),
        limits[0],
        limits[1]
    );
    median <= limits[0] && decile <= limits[1]
}

fn collect(folder: &Path, files: &mut Vec<PathBuf>) -> Result<()> {
    let entries = fs::read_dir(folder).with_context(|| format!("{} cannot be listed", folder.display()))?;
    let mut paths = entries.map(|entry| Ok(entry?.path())).collect::<Result<Vec<_>>>()?;
    paths.sort();
    for path in paths {
        if path.is_dir() {
            collect(&path, files)?;
        } else if path.extension().is_some_and(|extension| extension == "rs") {
            files.push(path);
        }
    }
    Ok(())
}

/// Functions of formatted code: from the line with `fn` to the closing brace at its indentation.
fn functions_of(text: &str, path: &Path) -> Vec<Function> {
    let lines: Vec<&str> = text.lines().collect();
    let mut functions = Vec::new();
    for (start, line) in lines.iter().enumerate() {
        let code = line.trim_start();
        let indent = line.len() - code.len();
        let words = ["pub ", "pub(crate) ", "pub(super) ", "const ", "async ", "unsafe "];
        let mut rest = code;
        while let Some(next) = words.iter().find_map(|word| rest.strip_prefix(word)) {
            rest = next;
        }
        let Some(signature) = rest.strip_prefix("fn ") else { continue };
        let closing = format!("{}}}", &line[..indent]);
        let Some(length) = lines[start..].iter().position(|l| *l == closing) else { continue };
        let name = signature.split(['(', '<']).next().unwrap_or(signature);
        functions.push(Function { place: format!("{}:{} {name}", path.display(), start + 1), lines: length + 1 });
    }
    functions
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn functions_are_measured() {
        let text = "impl X {\n    pub const fn a() {\n        b();\n    }\n}\n\nfn b() {}\nfn c() {\n}\n";
        let found = functions_of(text, Path::new("x.rs"));
        let sizes: Vec<(&str, usize)> = found.iter().map(|f| (f.place.as_str(), f.lines)).collect();
        assert_eq!(sizes, [("x.rs:2 a", 3), ("x.rs:7 b", 3), ("x.rs:8 c", 2)]);
    }
}
