//! The runtime's shaders in other languages, written from its WGSL by naga.

use crate::generated::write_or_check;
use anyhow::{Context, Result, anyhow};
use naga::{
    Module, ShaderStage,
    back::{glsl, hlsl, msl},
    front::wgsl,
    proc::BoundsCheckPolicies,
    valid::{Capabilities, ModuleInfo, ValidationFlags, Validator},
};
use std::{fs, path::Path};

const FOLDER: &str = "crates/kiln-runtime/shaders";

/// GLSL is written for an entry point, which nobody needs: it is added here and cut off again.
const ENTRY_POINT: &str = "\n@compute @workgroup_size(1) fn main() {}\n";

pub(crate) fn run(is_check: bool) -> Result<()> {
    let folder = Path::new(FOLDER);
    let source = folder.join("kiln_runtime.wgsl");
    let text = fs::read_to_string(&source).with_context(|| format!("{} cannot be read", source.display()))?;
    let paths = ["hlsl", "glsl", "metal"].map(|extension| folder.join(format!("kiln_runtime.{extension}")));
    let [hlsl, glsl, metal] = &paths;
    let files = [(hlsl.as_path(), to_hlsl(&text)?), (glsl, to_glsl(&text)?), (metal, to_metal(&text)?)];
    write_or_check(&files, is_check, "cargo xtask shaders")
}

fn parse(text: &str) -> Result<(Module, ModuleInfo)> {
    let module = wgsl::parse_str(text).map_err(|error| anyhow!("{}", error.emit_to_string(text)))?;
    // Halves in words, which all of these languages and WebGPU have.
    let halves = Capabilities::SHADER_FLOAT16_IN_FLOAT32;
    let info = Validator::new(ValidationFlags::all(), halves).validate(&module);
    Ok((module, info.map_err(|error| anyhow!("{}", error.emit_to_string(text)))?))
}

/// With a head that says where it comes from.
fn headed(needs: &str, code: &str) -> String {
    let code = code.trim();
    format!(
        "// Written from kiln_runtime.wgsl by `cargo xtask shaders`: change that file, and see it for what functions do.\n// {needs}\n\n{code}\n"
    )
}

fn to_hlsl(text: &str) -> Result<String> {
    let (module, info) = parse(text)?;
    let options = hlsl::Options { force_loop_bounding: false, ..hlsl::Options::default() };
    let pipeline = hlsl::PipelineOptions::default();
    let mut code = String::new();
    hlsl::Writer::new(&mut code, &options, &pipeline).write(&module, &info, None)?;
    Ok(headed("Needs shader model 5.1.", &code))
}

fn to_glsl(text: &str) -> Result<String> {
    let (module, info) = parse(&format!("{text}{ENTRY_POINT}"))?;
    let options = glsl::Options { version: glsl::Version::Desktop(420), ..glsl::Options::default() };
    let pipeline =
        glsl::PipelineOptions { shader_stage: ShaderStage::Compute, entry_point: "main".to_owned(), multiview: None };
    let mut code = String::new();
    glsl::Writer::new(&mut code, &module, &info, &options, &pipeline, BoundsCheckPolicies::default())?.write()?;
    let start = code.find("struct ").context("naga's GLSL has no struct")?;
    let end = code.find("void main()").context("naga's GLSL has no entry point")?;
    Ok(headed("Needs #version 420, or #version 310 es.", &code[start..end]))
}

fn to_metal(text: &str) -> Result<String> {
    let (module, info) = parse(text)?;
    let options = msl::Options { lang_version: (2, 0), force_loop_bounding: false, ..msl::Options::default() };
    let mut code = String::new();
    msl::Writer::new(&mut code).write(&module, &info, &options, &msl::PipelineOptions::default())?;
    let code = named(&code, "uint inner[17]", "KilnWords")?;
    let code = named(&code, "metal::float4 inner[16]", "KilnCurve")?;
    Ok(headed("Needs Metal 2.0.", &code))
}

/// Metal has no arrays as arguments: naga wraps them in structs that it numbers. This gives the one with a member its name.
fn named(code: &str, member: &str, name: &str) -> Result<String> {
    let before = code.split_once(member).with_context(|| format!("naga's Metal has no `{member}`"))?.0;
    let number = before.rsplit("struct ").next().and_then(|rest| rest.split_whitespace().next());
    let number = number.with_context(|| format!("naga's Metal has no struct around `{member}`"))?;
    let is_of_a_word = |c: char| c.is_alphanumeric() || c == '_';
    let words = code.split_inclusive(|c| !is_of_a_word(c));
    Ok(words
        .map(|word| {
            if word.trim_end_matches(|c| !is_of_a_word(c)) == number {
                word.replace(number, name)
            } else {
                word.to_owned()
            }
        })
        .collect())
}
