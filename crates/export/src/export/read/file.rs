//! Reads files into memory: regular ones only, and no more than the limit.

use super::error::ReadError;
use super::limits;
use std::fs::{File, FileType};
use std::io::Read;
use std::path::Path;

/// The contents of a regular file, of which at most `room` bytes are read.
///
/// # Errors
/// [`ReadError::NotAFile`] without opening the path, as opening a pipe waits for its other end;
/// [`ReadError::TooLarge`], [`ReadError::Io`].
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
    // The length is that of the moment, and 0 for files that the system makes up.
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
