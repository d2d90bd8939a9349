//! Rows of numbers that are kept in files from one process to the next.

use std::fs;
use std::hash::{DefaultHasher, Hash, Hasher};
use std::io;
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicU64, Ordering};
use std::time::SystemTime;

use octoarm_arm::ParameterError;

/// The environment variable that names the folder.
const VARIABLE: &str = "OCTOARM_CACHE";
/// Most bytes in a folder; the oldest files make room for new ones.
const MOST_BYTES: u64 = 1 << 30;
/// How the names of files end.
const EXTENSION: &str = "numbers";

/// A folder of files, each of which holds the numbers that were found for a text, its key.
#[derive(Clone, Debug)]
pub(crate) struct NumberFiles {
    folder: PathBuf,
}

fn hash_of(bytes: &[u8]) -> u64 {
    let mut hasher = DefaultHasher::new();
    bytes.hash(&mut hasher);
    hasher.finish()
}

impl NumberFiles {
    /// Those of a folder, which need not be there yet.
    pub(crate) fn in_folder(folder: PathBuf) -> Self {
        Self { folder }
    }

    /// Those of the folder that the environment variable `OCTOARM_CACHE` names; none without it.
    pub(crate) fn of_user() -> Option<Self> {
        let folder = std::env::var_os(VARIABLE).filter(|folder| !folder.is_empty())?;
        Some(Self::in_folder(folder.into()))
    }

    fn path(&self, key: &str) -> PathBuf {
        self.folder.join(format!("{:016x}.{EXTENSION}", hash_of(key.as_bytes())))
    }

    /// What was kept for the key; nothing if the file is not there, or not whole, or another key's.
    pub(crate) fn read(&self, key: &str) -> Option<Vec<f64>> {
        let bytes = fs::read(self.path(key)).ok()?;
        let (content, hash) = bytes.split_last_chunk::<8>()?;
        let numbers = content.strip_prefix(key.as_bytes())?.strip_prefix(b"\n")?;
        let (numbers, rest) = numbers.as_chunks::<8>();
        let whole = rest.is_empty() && u64::from_le_bytes(*hash) == hash_of(content);
        whole.then(|| numbers.iter().map(|number| f64::from_le_bytes(*number)).collect())
    }

    /// Keeps numbers for a key, in the place of what was kept for it.
    ///
    /// # Errors
    /// [`ParameterError`] that names the environment variable and its folder.
    pub(crate) fn write(
        &self,
        key: &str,
        numbers: impl IntoIterator<Item = f64>,
    ) -> Result<(), ParameterError> {
        let mut bytes = format!("{key}\n").into_bytes();
        bytes.extend(numbers.into_iter().flat_map(f64::to_le_bytes));
        bytes.extend(hash_of(&bytes).to_le_bytes());
        self.put(&self.path(key), &bytes).map_err(|error| {
            let range = format!("of folders that can be written: {error}");
            ParameterError::out_of_range(VARIABLE, self.folder.display(), range)
        })
    }

    fn put(&self, path: &Path, bytes: &[u8]) -> io::Result<()> {
        static COUNT: AtomicU64 = AtomicU64::new(0);
        fs::create_dir_all(&self.folder)?;
        self.make_room(bytes.len() as u64)?;
        // Others, of this process or another one, may write the same file now.
        let count = COUNT.fetch_add(1, Ordering::Relaxed);
        let unfinished = path.with_extension(format!("{}-{count}.tmp", std::process::id()));
        let done = fs::write(&unfinished, bytes).and_then(|()| fs::rename(&unfinished, path));
        if done.is_err() {
            let _ = fs::remove_file(&unfinished);
        }
        done
    }

    /// Removes the oldest files, until there is room for so many bytes more.
    fn make_room(&self, bytes: u64) -> io::Result<()> {
        let mut files: Vec<(SystemTime, u64, PathBuf)> = Vec::new();
        for entry in fs::read_dir(&self.folder)? {
            let path = entry?.path();
            if path.extension().is_some_and(|extension| extension == EXTENSION) {
                // One that is gone meanwhile takes no room.
                if let Ok(known) = fs::metadata(&path) {
                    files.push((known.modified()?, known.len(), path));
                }
            }
        }
        let mut taken = files.iter().map(|(_, length, _)| length).sum::<u64>() + bytes;
        files.sort_unstable();
        for (_, length, path) in files {
            if taken <= MOST_BYTES {
                break;
            }
            let _ = fs::remove_file(path);
            taken -= length;
        }
        Ok(())
    }
}
