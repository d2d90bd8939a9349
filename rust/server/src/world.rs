//! The worlds of a server: who made them, who has joined them, what waits for them.

use std::collections::HashMap;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

use tokio::sync::oneshot;
use tonic::Code;

use crate::arena::Arena;
use crate::metrics::Metrics;
use crate::reply::{Answer, Refusal, quoted};
use crate::settings::Limits;
use crate::specs::Specs;
use crate::world_settings::NextReset;

/// A world, as its client and others know it. Its arms are with the client that has joined it.
#[derive(Debug)]
pub(crate) struct World {
    /// Not to be guessed.
    pub(crate) name: String,
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
    /// Arms, by their size.
    arms: usize,
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
    /// Whether the joined client itself waits for the reset of another world.
    waiting: bool,
    /// Resets that wait for the joined client's next step.
    resets: Vec<(NextReset, oneshot::Sender<()>)>,
}

type List = HashMap<String, Entry>;

/// What is taken of what may be.
#[derive(Debug, Default)]
struct Places {
    /// Worlds, of every connection that has some.
    worlds: HashMap<u64, usize>,
    /// Arms of all worlds.
    arms: usize,
}

/// Arms on their way: whatever becomes of who took them, they come back to their world, or, if they
/// are lost, it is given up.
#[derive(Debug)]
pub(crate) struct Borrowed {
    worlds: Arc<Worlds>,
    world: Arc<World>,
    arena: Option<Arena>,
    returned: bool,
}

impl Borrowed {
    /// The arms of a world that a stream has joined.
    pub(crate) fn new(worlds: Arc<Worlds>, world: Arc<World>, arena: Arena) -> Self {
        Self { worlds, world, arena: Some(arena), returned: false }
    }

    /// Does something to the arms; none, if they are lost by it.
    pub(crate) fn with<T>(
        &mut self,
        work: impl FnOnce(&mut Arena, &World) -> Option<T>,
    ) -> Option<T> {
        let mut arena = self.arena.take()?;
        let result = work(&mut arena, &self.world)?;
        self.arena = Some(arena);
        Some(result)
    }

    /// The stream has them again.
    pub(crate) fn unwrap(mut self) -> Option<(Arc<World>, Arena)> {
        let arena = self.arena.take()?;
        self.returned = true;
        Some((Arc::clone(&self.world), arena))
    }
}

impl Drop for Borrowed {
    fn drop(&mut self) {
        match self.arena.take() {
            Some(arena) => self.worlds.leave(&self.world, arena),
            None if self.returned => {}
            None => self.worlds.lose(&self.world),
        }
    }
}

/// All worlds.
pub(crate) struct Worlds {
    list: Mutex<List>,
    places: Mutex<Places>,
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
        places.arms -= self.arms;
        if let Some(count) = places.worlds.get_mut(&self.connection) {
            *count -= 1;
            if *count == 0 {
                places.worlds.remove(&self.connection);
            }
        }
        self.worlds.metrics.worlds.dec();
    }
}

impl World {
    /// A world of the given name.
    pub(crate) fn new(name: String, specs: Specs) -> Self {
        Self { name, specs, attention: AtomicBool::new(false) }
    }

    /// Whether a reset of the world waits.
    pub(crate) fn attention(&self) -> bool {
        self.attention.load(Ordering::Acquire)
    }
}

fn unknown(name: &str) -> Refusal {
    Refusal::new(Code::NotFound, format!("world_name = {}: there is no such world", quoted(name)))
}

impl Worlds {
    /// None yet.
    pub(crate) fn new(limits: Limits, metrics: Arc<Metrics>) -> Arc<Self> {
        Arc::new(Self { list: Mutex::default(), places: Mutex::default(), limits, metrics })
    }

    fn lock_places(&self) -> MutexGuard<'_, Places> {
        self.places.lock().unwrap_or_else(PoisonError::into_inner)
    }

    fn lock(&self) -> MutexGuard<'_, List> {
        self.list.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Number of worlds.
    pub(crate) fn len(&self) -> usize {
        self.lock().len()
    }

    /// A place for a world of so many arms, made through this connection.
    pub(crate) fn reserve(self: &Arc<Self>, connection: u64, arms: usize) -> Answer<Place> {
        let mut places = self.lock_places();
        let all: usize = places.worlds.values().sum();
        let own = places.worlds.get(&connection).copied().unwrap_or(0);
        for (limit, taken, more, what, whose) in [
            (self.limits.max_worlds, all, 1, "worlds", "this server"),
            (self.limits.max_worlds_per_connection, own, 1, "worlds", "one connection"),
            (self.limits.max_arms, places.arms, arms, "arms", "this server"),
        ] {
            if taken.saturating_add(more) > limit {
                return Err(Refusal::exhausted(format!(
                    "{taken} {what} are taken of the {limit} that {whose} may have, {more} more are \
                     asked for: destroy a world first"
                )));
            }
        }
        *places.worlds.entry(connection).or_default() += 1;
        places.arms += arms;
        self.metrics.worlds.inc();
        Ok(Place { worlds: Arc::clone(self), connection, arms })
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
            waiting: false,
            resets: Vec::new(),
        };
        self.lock().insert(name, entry);
    }

    /// Takes the arms of a world that nobody else has joined.
    pub(crate) fn join(&self, name: &str) -> Answer<(Arc<World>, Arena)> {
        let mut list = self.lock();
        let entry = list.get_mut(name).ok_or_else(|| unknown(name))?;
        let arena = entry.arena.take().ok_or_else(|| {
            Refusal::precondition("the world is joined already; it takes one client")
        })?;
        Ok((Arc::clone(&entry.world), arena))
    }

    /// Gives the arms of a world back.
    pub(crate) fn leave(&self, world: &World, mut arena: Arena) {
        let mut list = self.lock();
        let Some(entry) = list.get_mut(&world.name) else { return };
        arena.leave();
        Self::settle(entry, &mut arena);
        entry.waiting = false;
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
        let mut any = false;
        for (next, done) in entry.resets.drain(..) {
            // Who asked may be gone, and the wish with it.
            if !done.is_closed() {
                arena.reset(next);
                any = true;
                let _ = done.send(());
            }
        }
        any
    }

    /// Resets a world: at once, or, if a client has joined it, at that client's next step; the receiver
    /// then tells when. `own` is the world that the asking stream has joined: while it waits, its own
    /// world cannot be waited for, lest two wait for each other.
    pub(crate) fn reset(
        &self,
        name: &str,
        own: Option<&str>,
        next: NextReset,
    ) -> Answer<Option<oneshot::Receiver<()>>> {
        let mut list = self.lock();
        let entry = list.get_mut(name).ok_or_else(|| unknown(name))?;
        if let Some(arena) = &mut entry.arena {
            arena.reset(next);
            return Ok(None);
        }
        if entry.waiting {
            return Err(Refusal::precondition(
                "the world's client waits itself for the reset of a world: try again later",
            ));
        }
        let (done, receiver) = oneshot::channel();
        entry.resets.retain(|(_, waiting)| !waiting.is_closed());
        entry.resets.push((next, done));
        entry.world.attention.store(true, Ordering::Release);
        if let Some(own) = own.and_then(|own| list.get_mut(own)) {
            own.waiting = true;
        }
        Ok(Some(receiver))
    }

    /// The client that has joined this world waits no longer.
    pub(crate) fn waited(&self, name: &str) {
        if let Some(entry) = self.lock().get_mut(name) {
            entry.waiting = false;
        }
    }

    /// Frees a world that nobody has joined.
    pub(crate) fn destroy(&self, name: &str) -> Answer<()> {
        let mut list = self.lock();
        let entry = list.get(name).ok_or_else(|| unknown(name))?;
        if entry.arena.is_none() {
            return Err(Refusal::precondition(
                "the world is joined: its client must leave it first",
            ));
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
