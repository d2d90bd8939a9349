//! The worlds of a server: who made them, who has joined them, what waits for them.

use std::collections::HashMap;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

use tokio::sync::oneshot;
use tonic::Code;

use crate::arena::Arena;
use crate::metrics::Metrics;
use crate::reply::{Answer, Refusal};
use crate::settings::Limits;
use crate::specs::Specs;
use crate::world_settings::NextReset;

/// A world, as its client and others know it. Its arms are with the client that has joined it.
#[derive(Debug)]
pub(crate) struct World {
    /// Not to be guessed.
    pub(crate) name: String,
    /// The settings of an episode, as JSON text.
    pub(crate) settings: String,
    /// What can be done and seen.
    pub(crate) specs: Specs,
    /// Whether a reset of the world waits for the joined client's next step.
    attention: AtomicBool,
}

/// A world that is being made: it has its place among those that are allowed.
#[derive(Debug)]
pub(crate) struct Place {
    worlds: Arc<Worlds>,
    connection: u64,
}

/// A world on the list.
struct Entry {
    world: Arc<World>,
    /// Kept for as long as the world.
    _place: Place,
    /// The stream that made it.
    owner: u64,
    /// Whether that stream has ended.
    orphan: bool,
    /// The arms, if nobody has joined.
    arena: Option<Arena>,
    /// Resets that wait for the joined client's next step.
    resets: Vec<(NextReset, oneshot::Sender<()>)>,
}

type List = HashMap<String, Entry>;

/// All worlds.
pub(crate) struct Worlds {
    list: Mutex<List>,
    /// Places taken, of every connection that has some.
    places: Mutex<HashMap<u64, usize>>,
    limits: Limits,
    metrics: Arc<Metrics>,
}

impl std::fmt::Debug for Worlds {
    fn fmt(&self, formatter: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        formatter.debug_struct("Worlds").finish_non_exhaustive()
    }
}

impl Drop for Place {
    fn drop(&mut self) {
        let mut places = self.worlds.lock_places();
        if let Some(count) = places.get_mut(&self.connection) {
            *count -= 1;
            if *count == 0 {
                places.remove(&self.connection);
            }
        }
        self.worlds.metrics.worlds.dec();
    }
}

impl World {
    /// A world of the given name.
    pub(crate) fn new(name: String, settings: String, specs: Specs) -> Self {
        Self { name, settings, specs, attention: AtomicBool::new(false) }
    }

    /// Whether a reset of the world waits.
    pub(crate) fn attention(&self) -> bool {
        self.attention.load(Ordering::Acquire)
    }
}

fn unknown(name: &str) -> Refusal {
    Refusal::new(Code::NotFound, format!("world_name = {name:?}: there is no such world"))
}

impl Worlds {
    /// None yet.
    pub(crate) fn new(limits: Limits, metrics: Arc<Metrics>) -> Arc<Self> {
        Arc::new(Self { list: Mutex::default(), places: Mutex::default(), limits, metrics })
    }

    fn lock_places(&self) -> MutexGuard<'_, HashMap<u64, usize>> {
        self.places.lock().unwrap_or_else(PoisonError::into_inner)
    }

    fn lock(&self) -> MutexGuard<'_, List> {
        self.list.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Number of worlds.
    pub(crate) fn len(&self) -> usize {
        self.lock().len()
    }

    /// A place for a world of this connection.
    pub(crate) fn reserve(self: &Arc<Self>, connection: u64) -> Answer<Place> {
        let mut places = self.lock_places();
        let all: usize = places.values().sum();
        let own = places.get(&connection).copied().unwrap_or(0);
        for (limit, count, whose) in [
            (self.limits.max_worlds, all, "this server"),
            (self.limits.max_worlds_per_connection, own, "one connection"),
        ] {
            if count >= limit {
                return Err(Refusal::exhausted(format!(
                    "there are {count} worlds, all that {whose} may have: destroy one first"
                )));
            }
        }
        *places.entry(connection).or_default() += 1;
        self.metrics.worlds.inc();
        Ok(Place { worlds: Arc::clone(self), connection })
    }

    /// Puts a world on the list, made by stream `owner`.
    pub(crate) fn insert(&self, world: Arc<World>, arena: Arena, place: Place, owner: u64) {
        let name = world.name.clone();
        let entry = Entry {
            world,
            _place: place,
            owner,
            orphan: false,
            arena: Some(arena),
            resets: Vec::new(),
        };
        self.lock().insert(name, entry);
    }

    /// Takes the arms of a world that nobody else has joined.
    pub(crate) fn join(&self, name: &str) -> Answer<(Arc<World>, Arena)> {
        let mut list = self.lock();
        let entry = list.get_mut(name).ok_or_else(|| unknown(name))?;
        let arena = entry.arena.take().ok_or_else(|| {
            Refusal::precondition(format!("world {name:?} is joined already; it takes one client"))
        })?;
        Ok((Arc::clone(&entry.world), arena))
    }

    /// Gives the arms of a world back.
    pub(crate) fn leave(&self, world: &World, mut arena: Arena) {
        let mut list = self.lock();
        let Some(entry) = list.get_mut(&world.name) else { return };
        Self::settle(entry, &mut arena);
        // The episode is over with the client's leaving.
        arena.reset(NextReset::default());
        entry.arena = Some(arena);
        let gone = if entry.orphan { list.remove(&world.name) } else { None };
        drop(list);
        drop(gone);
    }

    /// The joined client's arms are lost, and the world with them.
    pub(crate) fn lose(&self, world: &World) {
        let gone = self.lock().remove(&world.name);
        drop(gone);
    }

    /// Hands the resets that waited for the joined client to its arms; whether there were any.
    pub(crate) fn interrupt(&self, world: &World, arena: &mut Arena) -> bool {
        let mut list = self.lock();
        list.get_mut(&world.name).is_some_and(|entry| Self::settle(entry, arena))
    }

    fn settle(entry: &mut Entry, arena: &mut Arena) -> bool {
        entry.world.attention.store(false, Ordering::Release);
        let any = !entry.resets.is_empty();
        for (next, done) in entry.resets.drain(..) {
            arena.reset(next);
            // Who asked may be gone.
            let _ = done.send(());
        }
        any
    }

    /// Resets a world: at once, or, if a client has joined it, at that client's next step; the receiver
    /// then tells when.
    pub(crate) fn reset(
        &self,
        name: &str,
        next: NextReset,
    ) -> Answer<Option<oneshot::Receiver<()>>> {
        let mut list = self.lock();
        let entry = list.get_mut(name).ok_or_else(|| unknown(name))?;
        if let Some(arena) = &mut entry.arena {
            arena.reset(next);
            return Ok(None);
        }
        let (done, receiver) = oneshot::channel();
        entry.resets.retain(|(_, waiting)| !waiting.is_closed());
        entry.resets.push((next, done));
        entry.world.attention.store(true, Ordering::Release);
        Ok(Some(receiver))
    }

    /// Frees a world that nobody has joined.
    pub(crate) fn destroy(&self, name: &str) -> Answer<()> {
        let mut list = self.lock();
        let entry = list.get(name).ok_or_else(|| unknown(name))?;
        if entry.arena.is_none() {
            return Err(Refusal::precondition(format!(
                "world {name:?} is joined: its client must leave it first"
            )));
        }
        let gone = list.remove(name);
        drop(list);
        drop(gone);
        Ok(())
    }

    /// Frees what a stream made; a world that another one has joined goes when that one leaves.
    pub(crate) fn release(&self, owner: u64) {
        let mut list = self.lock();
        let mut gone = Vec::new();
        list.retain(|_, entry| {
            if entry.owner != owner {
                return true;
            }
            entry.orphan = true;
            if let Some(arena) = entry.arena.take() {
                gone.push(arena);
                return false;
            }
            true
        });
        drop(list);
        drop(gone);
    }
}
