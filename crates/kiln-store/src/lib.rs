//! Artefacts by digest, results by task key, and the journal.
