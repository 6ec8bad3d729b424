//! `kiln serve`: the coordinator of a farm.

use crate::{
    args::{Common, ServeArgs},
    data_folder::data_folder,
    failure::Failure,
    local_farm::{STORE_MAX_BYTES, open_store},
    outcome::write_whole,
};
use anyhow::Context;
use kiln_coordinator::{Config, Coordinator, Token, listen};
use std::sync::Arc;

pub(crate) fn run(args: &ServeArgs, common: &Common) -> Result<(), Failure> {
    super::runtime()?.block_on(serve(args, common))
}

#[expect(clippy::print_stderr, reason = "the operator is told where the coordinator listens")]
async fn serve(args: &ServeArgs, common: &Common) -> Result<(), Failure> {
    let token = token(args)?;
    let incoming = listen(args.listen, token.as_ref()).map_err(Failure::usage)?;
    let folder = data_folder(common, "farm")?;
    let store = Arc::new(open_store(&folder, |text| eprintln!("{text}"))?);
    let config = Config { store_max_bytes: Some(STORE_MAX_BYTES), token, ..Config::default() };
    let coordinator = Coordinator::start(store, config).await.map_err(anyhow::Error::from)?;
    let address = incoming.local_addr().context("the listening address is unknown")?;
    if let Some(path) = &args.address_file {
        write_whole(path, format!("http://{address}\n").as_bytes())?;
    }
    eprintln!("kiln: listening on http://{address}, results in {}", folder.display());
    Ok(coordinator.serve(incoming, super::stop_signal()).await.map_err(anyhow::Error::from)?)
}

fn token(args: &ServeArgs) -> Result<Option<Token>, Failure> {
    if let Some(path) = &args.token_file {
        return Token::from_file(path).map(Some).map_err(Failure::usage);
    }
    std::env::var("KILN_TOKEN").ok().map(|text| Token::new(&text)).transpose().map_err(Failure::usage)
}
