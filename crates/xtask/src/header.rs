//! The runtime's header for C, written from its Rust by cbindgen.

use crate::generated::write_or_check;
use anyhow::Result;
use cbindgen::{Builder, Config, DocumentationStyle, EnumConfig, Language, RenameRule, Style};
use std::path::Path;

const SOURCE: &str = "crates/kiln-runtime/src/c_api/mod.rs";
const HEADER: &str = "crates/kiln-runtime/include/kiln_runtime.h";

const HEAD: &str = "/* What an engine needs of a Kiln bake: docs/runtime.md and docs/pack-format.md of Kiln. Written from crates/kiln-runtime/src/c_api\n   by `cargo xtask header`. Points are metres relative to the level's origin; AO is from 0 to 1, 1 open. */";

pub(crate) fn run(is_check: bool) -> Result<()> {
    let config = Config {
        language: Language::C,
        header: Some(HEAD.to_owned()),
        include_guard: Some("KILN_RUNTIME_H".to_owned()),
        cpp_compat: true,
        documentation_style: DocumentationStyle::C99,
        style: Style::Both,
        usize_is_size_t: true,
        enumeration: EnumConfig {
            rename_variants: RenameRule::ScreamingSnakeCase,
            prefix_with_name: true,
            ..EnumConfig::default()
        },
        ..Config::default()
    };
    // Its modules are read, too.
    let builder = Builder::new().with_config(config).with_src(SOURCE);
    let mut text = Vec::new();
    builder.generate()?.write(&mut text);
    write_or_check(&[(Path::new(HEADER), String::from_utf8(text)?)], is_check, "cargo xtask header")
}
