//! What the system allows the process.

use crate::settings::Limits;

/// Open files beside the connections: those of the runtime, of the log, of the metrics' readers.
#[cfg(unix)]
const OTHER_FILES: u64 = 64;

/// Raises the limit of open files so that there is one for every connection, or else has fewer of them.
#[cfg(unix)]
pub(crate) fn fit_open_files(limits: &mut Limits) {
    use rustix::process::{Resource, Rlimit, getrlimit, setrlimit};
    let needed = limits.max_connections as u64 + OTHER_FILES;
    let Rlimit { current, maximum } = getrlimit(Resource::Nofile);
    let enough = |limit: Option<u64>| limit.is_none_or(|limit| limit >= needed);
    if enough(current) {
        return;
    }
    let raised = if enough(maximum) { Some(needed) } else { maximum };
    let limit = match setrlimit(Resource::Nofile, Rlimit { current: raised, maximum }) {
        Ok(()) => raised,
        Err(_) => current,
    };
    if !enough(limit) {
        let fewer = limit.unwrap_or(0).saturating_sub(OTHER_FILES).max(1) as usize;
        tracing::warn!(
            max_connections = limits.max_connections,
            allowed = fewer,
            "fewer connections: the system allows the process no more open files"
        );
        limits.max_connections = fewer;
    }
}

#[cfg(not(unix))]
pub(crate) fn fit_open_files(_: &mut Limits) {}
