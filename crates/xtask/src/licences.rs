//! Licences of every dependency, read from cargo's metadata: all must be permissive.

use anyhow::{Context, Result, bail};
use std::process::Command;

const PERMISSIVE: [&str; 13] = [
    "0BSD",
    "Apache-2.0",
    "Apache-2.0 WITH LLVM-exception",
    "BSD-2-Clause",
    "BSD-3-Clause",
    "BSL-1.0",
    "CC0-1.0",
    "ISC",
    "MIT",
    "MIT-0",
    "MPL-2.0",
    "Unicode-3.0",
    "Zlib",
];

#[expect(clippy::print_stdout, reason = "this is the chore's output")]
pub(crate) fn run() -> Result<()> {
    let output = Command::new(env!("CARGO")).args(["metadata", "--format-version", "1", "--locked"]).output()?;
    if !output.status.success() {
        bail!("cargo metadata failed: {}", String::from_utf8_lossy(&output.stderr));
    }
    let metadata: serde_json::Value = serde_json::from_slice(&output.stdout)?;
    let packages = metadata["packages"].as_array().context("cargo metadata lists no packages")?;
    let mut refused = 0;
    for package in packages {
        let licence = package["license"].as_str().unwrap_or("none stated");
        if !is_permissive(licence) {
            println!("{} {}: {licence}", package["name"], package["version"]);
            refused += 1;
        }
    }
    if refused > 0 {
        bail!(
            "{refused} dependencies have a licence that is not permissive; replace them, or add the licence to the list if it is"
        );
    }
    println!("{} packages, all under permissive licences", packages.len());
    Ok(())
}

/// Whether an SPDX expression offers a choice that is permissive throughout. `AND` binds before `OR`; the old `/` means `OR`.
fn is_permissive(expression: &str) -> bool {
    let spaced = expression.replace('/', " OR ").replace('(', " ( ").replace(')', " ) ");
    let tokens: Vec<&str> = spaced.split_whitespace().collect();
    let mut rest = &tokens[..];
    any_of(&mut rest) && rest.is_empty()
}

fn any_of(tokens: &mut &[&str]) -> bool {
    let mut is_good = all_of(tokens);
    while let ["OR", rest @ ..] = tokens {
        *tokens = rest;
        is_good |= all_of(tokens);
    }
    is_good
}

fn all_of(tokens: &mut &[&str]) -> bool {
    let mut is_good = one(tokens);
    while let ["AND", rest @ ..] = tokens {
        *tokens = rest;
        is_good &= one(tokens);
    }
    is_good
}

fn one(tokens: &mut &[&str]) -> bool {
    match *tokens {
        ["(", rest @ ..] => {
            *tokens = rest;
            let is_good = any_of(tokens);
            if let [")", rest @ ..] = tokens {
                *tokens = rest;
            }
            is_good
        }
        [licence, "WITH", exception, rest @ ..] => {
            *tokens = rest;
            PERMISSIVE.contains(&format!("{licence} WITH {exception}").as_str()) || PERMISSIVE.contains(licence)
        }
        [licence, rest @ ..] => {
            *tokens = rest;
            PERMISSIVE.contains(licence)
        }
        [] => false,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn expressions() {
        for good in [
            "MIT",
            "MIT/Apache-2.0",
            "(MIT OR GPL-3.0) AND Unicode-3.0",
            "GPL-2.0 OR ISC",
            "Apache-2.0 WITH LLVM-exception",
        ] {
            assert!(is_permissive(good), "{good}");
        }
        for bad in ["GPL-3.0", "MIT AND GPL-3.0", "none stated", "", "(MIT OR ISC) AND AGPL-3.0"] {
            assert!(!is_permissive(bad), "{bad}");
        }
    }
}
