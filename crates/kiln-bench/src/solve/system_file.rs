//! Linear systems and answers as files, for programs that solve them in a process of their own.
//!
//! Little-endian: `kilnSYS1`, u64 unknowns n, u64 entries, u64 columns k; u32 column starts (n + 1), u32 rows, f64
//! values of the lower triangle; f64 right-hand sides (n × k); then, for Kiln alone, f64 anchor (n) and u32 hole
//! rings (n). Answers are f64, shaped as the right-hand sides.

use crate::BenchError;
use bytemuck::Pod;
use kiln_solve::{ComponentSystem, matrix::LowerCsc, system::MAX_COLUMNS};
use std::{
    borrow::Cow,
    fs::File,
    io::{self, BufReader, BufWriter, Read, Write},
    path::Path,
};

const MAGIC: [u8; 8] = *b"kilnSYS1";

/// Writes a system.
pub(super) fn write(path: &Path, system: &ComponentSystem<'_>) -> Result<(), BenchError> {
    let all = || {
        let mut out = BufWriter::new(File::create(path)?);
        out.write_all(&MAGIC)?;
        let sizes = [system.len(), system.matrix.entry_count(), system.columns].map(|size| size as u64);
        put(&mut out, &sizes)?;
        put(&mut out, &system.matrix.column_start)?;
        put(&mut out, &system.matrix.row)?;
        put(&mut out, &system.matrix.value)?;
        put(&mut out, &system.rhs)?;
        put(&mut out, &system.anchor)?;
        put(&mut out, &system.hole_ring)?;
        out.flush()
    };
    all().map_err(|error| file_error(path, &error))
}

/// Reads a system back.
pub(super) fn read(path: &Path) -> Result<ComponentSystem<'static>, BenchError> {
    let all = || {
        let mut file = BufReader::new(File::open(path)?);
        let mut magic = [0; 8];
        file.read_exact(&mut magic)?;
        let [n, entries, columns] = <[u64; 3]>::try_from(take::<u64>(&mut file, 3)?)
            .map_err(|_| io::Error::from(io::ErrorKind::UnexpectedEof))?
            .map(|size| size as usize);
        if magic != MAGIC || !(1..=MAX_COLUMNS).contains(&columns) {
            return Err(io::Error::new(io::ErrorKind::InvalidData, "it is no system of kiln bench solve"));
        }
        let matrix = LowerCsc {
            column_start: take(&mut file, n + 1)?,
            row: take(&mut file, entries)?,
            value: take(&mut file, entries)?,
        };
        Ok(ComponentSystem {
            matrix: Cow::Owned(matrix),
            rhs: Cow::Owned(take(&mut file, n * columns)?),
            anchor: Cow::Owned(take(&mut file, n)?),
            hole_ring: Cow::Owned(take(&mut file, n)?),
            columns,
        })
    };
    all().map_err(|error| file_error(path, &error))
}

/// Writes an answer.
pub(super) fn write_answer(path: &Path, x: &[f64]) -> Result<(), BenchError> {
    std::fs::write(path, bytemuck::cast_slice(x)).map_err(|error| file_error(path, &error))
}

/// Reads an answer of `len` values.
pub(super) fn read_answer(path: &Path, len: usize) -> Result<Vec<f64>, BenchError> {
    File::open(path).and_then(|mut file| take(&mut file, len)).map_err(|error| file_error(path, &error))
}

fn put<T: Pod>(out: &mut impl Write, values: &[T]) -> io::Result<()> {
    out.write_all(bytemuck::cast_slice(values))
}

fn take<T: Pod>(from: &mut impl Read, len: usize) -> io::Result<Vec<T>> {
    let mut values = vec![T::zeroed(); len];
    from.read_exact(bytemuck::cast_slice_mut(&mut values))?;
    Ok(values)
}

fn file_error(path: &Path, error: &io::Error) -> BenchError {
    BenchError::File { path: path.to_path_buf(), reason: format!("{error}; check the folder and its free space") }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_is_written_is_read() -> Result<(), BenchError> {
        let matrix = LowerCsc { column_start: vec![0, 2, 3], row: vec![0, 1, 1], value: vec![4.0, 2.0, 3.0] };
        let system = ComponentSystem {
            matrix: Cow::Owned(matrix),
            anchor: Cow::Owned(vec![0.5, 0.25]),
            rhs: Cow::Owned(vec![1.0, 2.0, 3.0, 4.0]),
            columns: 2,
            hole_ring: Cow::Owned(vec![0, 7]),
        };
        let path = std::env::temp_dir().join(format!("kiln-bench-system-{}", std::process::id()));
        write(&path, &system)?;
        let found = read(&path)?;
        assert_eq!((found.matrix, found.rhs), (system.matrix, system.rhs));
        assert_eq!((found.anchor, found.hole_ring, found.columns), (system.anchor, system.hole_ring, 2));
        write_answer(&path, &[0.5, -1.5])?;
        assert_eq!(read_answer(&path, 2)?, [0.5, -1.5]);
        assert!(matches!(read(&path), Err(BenchError::File { .. })));
        std::fs::remove_file(&path).map_err(|error| file_error(&path, &error))
    }
}
