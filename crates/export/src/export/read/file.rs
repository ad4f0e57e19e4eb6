//! Reads regular files into memory, up to a limit.

use super::error::ReadError;
use super::limits;
use std::fs::{File, FileType};
use std::io::Read;
use std::path::Path;

/// Reads a regular file of at most `room` bytes.
///
/// # Errors
/// - [`ReadError::NotAFile`], without opening the path: opening a pipe would wait for its other
///   end.
/// - [`ReadError::TooLarge`] if the file has more than `room` bytes.
/// - [`ReadError::Io`] if it cannot be read.
pub(super) fn read(path: &Path, room: u64) -> Result<Vec<u8>, ReadError> {
    let io = |source| ReadError::Io { path: path.to_owned(), source };
    let kind = std::fs::metadata(path).map_err(io)?.file_type();
    if !kind.is_file() {
        return Err(ReadError::NotAFile { path: path.to_owned(), kind: describe(kind) });
    }
    let mut file = File::open(path).map_err(io)?;
    let length = file.metadata().map_err(io)?.len();
    let too_large = || ReadError::TooLarge {
        path: path.display().to_string(),
        what: "the file, with those it refers to, has more bytes".to_owned(),
        most: limits::BYTES,
    };
    if length > room {
        return Err(too_large());
    }
    let mut bytes = Vec::new();
    // The length may change while the file is read, and is 0 for files in /proc.
    bytes.try_reserve_exact(length as usize).map_err(|error| io(error.into()))?;
    file.by_ref().take(room.saturating_add(1)).read_to_end(&mut bytes).map_err(io)?;
    if bytes.len() as u64 > room {
        return Err(too_large());
    }
    Ok(bytes)
}

fn describe(kind: FileType) -> &'static str {
    #[cfg(unix)]
    {
        use std::os::unix::fs::FileTypeExt;
        if kind.is_fifo() {
            return "a pipe (FIFO)";
        }
        if kind.is_socket() {
            return "a socket";
        }
        if kind.is_char_device() || kind.is_block_device() {
            return "a device";
        }
    }
    if kind.is_dir() { "a directory" } else { "a special file" }
}
