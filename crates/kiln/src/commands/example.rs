//! `kiln example`: levels made by code.

use crate::{
    args::{Common, ExampleArgs},
    failure::Failure,
};
use anyhow::Context;
use kiln_scene::LevelFiles;

#[expect(clippy::print_stdout, reason = "this is the command's output")]
pub(crate) fn run(args: &ExampleArgs, common: &Common) -> Result<(), Failure> {
    let (Some(name), Some(output)) = (&args.name, &args.output) else {
        if common.json {
            let list: Vec<_> = kiln_scene::example::names()
                .iter()
                .map(|(name, about)| serde_json::json!({ "name": name, "description": about }))
                .collect();
            println!("{}", serde_json::Value::from(list));
            return Ok(());
        }
        for (name, description) in kiln_scene::example::names() {
            println!("{name:18} {description}");
        }
        return Ok(());
    };
    let glb = match &args.from {
        Some(level) if name == "lods" => {
            let files = LevelFiles::read(level, None).map_err(|error| Failure::refused(error.to_string()))?;
            kiln_scene::example::with_lods(&files.name, &files.files)
                .map_err(|error| Failure::refused(error.to_string()))?
        }
        Some(_) => return Err(Failure::usage("--from is for the example lods, which is made of a level")),
        None => kiln_scene::example::build(name).ok_or_else(|| {
            Failure::usage(format!("there is no example {name:?}; `kiln example --list` names them all"))
        })?,
    };
    std::fs::write(output, &glb).with_context(|| format!("{} cannot be written", output.display()))?;
    if common.json {
        println!("{}", serde_json::json!({ "path": output, "bytes": glb.len() }));
    } else {
        println!("wrote {} ({} bytes)", output.display(), glb.len());
    }
    Ok(())
}
