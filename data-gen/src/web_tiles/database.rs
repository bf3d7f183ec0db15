//! SQLite databases from outside: views in them are SQL of a stranger, which may run forever or take all memory.

use std::path::Path;
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};
use std::time::{Duration, Instant};

use rusqlite::config::DbConfig;
use rusqlite::limits::Limit;
use rusqlite::{Connection, OpenFlags};

use super::MAX_TILE_BYTES;

/// The number of SQLite's steps after which it asks whether to go on.
const STEPS_AT_ONCE: u64 = 10_000;
/// The most steps of a query, and more for each byte of the file: a row needs some ten, and has as many bytes.
const MAX_STEPS: u64 = 20_000_000;
const MAX_STEPS_PER_BYTE: u64 = 4;
/// The longest time of a query, and the bytes of the file for which a second more is allowed. Steps may be slow.
const MAX_TIME: Duration = Duration::from_secs(8);
const MIN_BYTES_PER_SECOND: u64 = 10 << 20;
/// The most memory of SQLite in the process: the cache of pages, and what queries sort.
const MAX_MEMORY_BYTES: usize = 256 << 20;

/// A database that is only read, and whose queries end.
pub(super) struct Database {
    connection: Connection,
    limits: Arc<Limits>,
}

/// The limits of a query, which its thread sets and SQLite's progress handler checks.
struct Limits {
    opened: Instant,
    max_steps: u64,
    max_time: Duration,
    /// The steps that are left.
    steps: AtomicU64,
    /// The end in milliseconds since `opened`.
    end_ms: AtomicU64,
}

impl Limits {
    fn new(file_bytes: u64) -> Self {
        Self {
            opened: Instant::now(),
            max_steps: MAX_STEPS.saturating_add(file_bytes.saturating_mul(MAX_STEPS_PER_BYTE)),
            max_time: MAX_TIME + Duration::from_secs(file_bytes / MIN_BYTES_PER_SECOND),
            steps: AtomicU64::new(0),
            end_ms: AtomicU64::new(0),
        }
    }

    fn now_ms(&self) -> u64 {
        self.opened.elapsed().as_millis().try_into().unwrap_or(u64::MAX)
    }

    /// Begins a query.
    fn restart(&self) {
        let end = self.now_ms().saturating_add(self.max_time.as_millis() as u64);
        self.end_ms.store(end, Ordering::Relaxed);
        self.steps.store(self.max_steps, Ordering::Relaxed);
    }

    /// Counts steps, and returns true if the query must end.
    fn is_over(&self) -> bool {
        let left = self.steps.load(Ordering::Relaxed).saturating_sub(STEPS_AT_ONCE);
        self.steps.store(left, Ordering::Relaxed);
        left == 0 || self.now_ms() > self.end_ms.load(Ordering::Relaxed)
    }
}

impl Database {
    /// Opens a file of a number of bytes. The error is the reason.
    pub fn open(path: &Path, file_bytes: u64) -> Result<Self, String> {
        let limits = Arc::new(Limits::new(file_bytes));
        let open = || {
            let flags = OpenFlags::SQLITE_OPEN_READ_ONLY | OpenFlags::SQLITE_OPEN_NO_MUTEX;
            let mut connection = Connection::open_with_flags(path, flags)?;
            connection.set_db_config(DbConfig::SQLITE_DBCONFIG_DEFENSIVE, true)?;
            connection.set_db_config(DbConfig::SQLITE_DBCONFIG_TRUSTED_SCHEMA, false)?;
            connection.set_limit(Limit::SQLITE_LIMIT_LENGTH, MAX_TILE_BYTES as i32 + 1024)?;
            connection.set_limit(Limit::SQLITE_LIMIT_ATTACHED, 0)?;
            let checked = Arc::clone(&limits);
            connection.progress_handler(STEPS_AT_ONCE as i32, Some(move || checked.is_over()))?;
            limits.restart();
            // Queries sort in memory, which has a limit, and not in a file, which has none.
            connection.execute_batch(&format!(
                "PRAGMA query_only = ON; PRAGMA temp_store = MEMORY; PRAGMA cell_size_check = ON; \
                 PRAGMA hard_heap_limit = {MAX_MEMORY_BYTES};"
            ))?;
            Ok(connection)
        };
        let connection = open().map_err(|e| reason(&e))?;
        Ok(Self { connection, limits })
    }

    /// Calls with the connection, for one query. The error is the reason.
    pub fn query<T>(&self, call: impl FnOnce(&Connection) -> rusqlite::Result<T>) -> Result<T, String> {
        self.limits.restart();
        call(&self.connection).map_err(|e| reason(&e))
    }
}

/// Returns the reason of an error.
fn reason(error: &rusqlite::Error) -> String {
    match error.sqlite_error_code() {
        Some(rusqlite::ErrorCode::OperationInterrupted) => {
            "a query takes more time than a file of this size needs; the database is damaged, or its views do not end"
                .to_owned()
        }
        Some(rusqlite::ErrorCode::OutOfMemory) => format!("a query needs more than {MAX_MEMORY_BYTES} bytes of memory"),
        Some(rusqlite::ErrorCode::TooBig) => format!("a value of more than {MAX_TILE_BYTES} bytes"),
        _ => error.to_string(),
    }
}
