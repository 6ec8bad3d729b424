//! Generates the gRPC types from `proto/kiln/v1` without a system protoc, and keeps the descriptor set for
//! reflection.

use prost::Message;
use std::{env, error::Error, fs, path::Path};

const FILES: [&str; 6] = ["task", "source", "bake", "artefact", "worker", "farm"];

fn main() -> Result<(), Box<dyn Error>> {
    let root = Path::new(&env::var("CARGO_MANIFEST_DIR")?).join("../../proto");
    println!("cargo::rerun-if-changed={}", root.display());
    let descriptors = protox::compile(FILES.map(|file| format!("kiln/v1/{file}.proto")), [root])?;
    let out = env::var("OUT_DIR")?;
    fs::write(Path::new(&out).join("kiln_descriptor.bin"), descriptors.encode_to_vec())?;
    tonic_prost_build::configure()
        .bytes(".kiln.v1.UploadChunk.data")
        .bytes(".kiln.v1.DownloadResponse.data")
        .emit_rerun_if_changed(false)
        .compile_fds(descriptors)?;
    Ok(())
}
