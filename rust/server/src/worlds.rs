//! The worlds of a server: who made them, who has joined them, and how many there may be.

use std::collections::HashMap;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

use tokio::sync::oneshot;
use tonic::Code;

use crate::metrics::Metrics;
use crate::next_reset::NextReset;
use crate::reply::{Answer, Refusal, quoted};
use crate::settings::Limits;
use crate::task_settings::TaskName;
use crate::world::World;

/// A world's share of what the server allows, from before it is made until it is gone.
#[derive(Debug)]
pub(crate) struct Reservation {
    worlds: Arc<Worlds>,
    connection: u64,
    /// Number of arms, weighed by their size.
    arms: usize,
    /// Memory that the world takes, rounded up.
    bytes: usize,
}

impl Drop for Reservation {
    fn drop(&mut self) {
        let mut taken = self.worlds.taken();
        taken.arms -= self.arms;
        taken.bytes -= self.bytes;
        self.worlds.metrics.world_bytes.set(taken.bytes as i64);
        if let Some(count) = taken.worlds.get_mut(&self.connection) {
            *count -= 1;
            if *count == 0 {
                taken.worlds.remove(&self.connection);
            }
        }
        self.worlds.metrics.worlds.dec();
    }
}

/// A client that has joined a world. It leaves when the last who works for it lets go: the stream,
/// or a step that outlives the stream.
#[derive(Debug)]
pub(crate) struct Agent {
    pub(crate) world: Arc<World>,
    worlds: Arc<Worlds>,
}

impl Drop for Agent {
    fn drop(&mut self) {
        self.worlds.leave(&self.world);
    }
}

/// A world on the list.
struct Entry {
    world: Arc<World>,
    /// Kept for as long as the world.
    _reservation: Reservation,
    /// The stream that made it.
    owner: u64,
    /// Whether that stream has ended.
    orphan: bool,
    /// Whether an agent has joined.
    joined: bool,
    /// Whether that agent itself waits for the reset of another world.
    waiting: bool,
}

type List = HashMap<String, Entry>;

/// What is taken of what may be.
#[derive(Debug, Default)]
struct Taken {
    /// Worlds, of every connection that has some.
    worlds: HashMap<u64, usize>,
    /// Arms of all worlds.
    arms: usize,
    /// Memory of all worlds.
    bytes: usize,
}

/// All worlds.
pub(crate) struct Worlds {
    list: Mutex<List>,
    taken: Mutex<Taken>,
    limits: Limits,
    metrics: Arc<Metrics>,
}

impl std::fmt::Debug for Worlds {
    fn fmt(&self, formatter: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        formatter.debug_struct("Worlds").finish_non_exhaustive()
    }
}

fn unknown(name: &str) -> Refusal {
    Refusal::new(Code::NotFound, format!("world_name = {}: there is no such world", quoted(name)))
}

impl Worlds {
    /// A list without worlds.
    pub(crate) fn new(limits: Limits, metrics: Arc<Metrics>) -> Arc<Self> {
        Arc::new(Self { list: Mutex::default(), taken: Mutex::default(), limits, metrics })
    }

    fn taken(&self) -> MutexGuard<'_, Taken> {
        self.taken.lock().unwrap_or_else(PoisonError::into_inner)
    }

    fn list(&self) -> MutexGuard<'_, List> {
        self.list.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Number of worlds.
    pub(crate) fn len(&self) -> usize {
        self.list().len()
    }

    /// Room for a world of so many arms and bytes, made through this connection.
    pub(crate) fn reserve(
        self: &Arc<Self>,
        connection: u64,
        arms: usize,
        bytes: usize,
    ) -> Answer<Reservation> {
        let mut all = self.taken();
        let worlds: usize = all.worlds.values().sum();
        let own = all.worlds.get(&connection).copied().unwrap_or(0);
        for (limit, taken, more, what, whose) in [
            (self.limits.max_worlds, worlds, 1, "worlds", "this server"),
            (self.limits.max_worlds_per_connection, own, 1, "worlds", "one connection"),
            (self.limits.max_arms, all.arms, arms, "arms", "this server"),
            (
                self.limits.max_world_bytes,
                all.bytes,
                bytes,
                "bytes of memory",
                "this server's worlds",
            ),
        ] {
            if taken.saturating_add(more) > limit {
                return Err(Refusal::exhausted(format!(
                    "{taken} {what} are taken of the {limit} that {whose} may have, {more} more are \
                     asked for: destroy a world first"
                )));
            }
        }
        *all.worlds.entry(connection).or_default() += 1;
        all.arms += arms;
        all.bytes += bytes;
        self.metrics.world_bytes.set(all.bytes as i64);
        self.metrics.worlds.inc();
        Ok(Reservation { worlds: Arc::clone(self), connection, arms, bytes })
    }

    /// Puts a world on the list, made by stream `owner`.
    pub(crate) fn insert(&self, world: World, reservation: Reservation, owner: u64) {
        let entry = Entry {
            world: Arc::new(world),
            _reservation: reservation,
            owner,
            orphan: false,
            joined: false,
            waiting: false,
        };
        self.list().insert(entry.world.name.clone(), entry);
    }

    /// What the arms of a world do.
    pub(crate) fn task(&self, name: &str) -> Option<TaskName> {
        self.list().get(name).map(|entry| entry.world.task)
    }

    /// Joins a world that nobody else has joined.
    pub(crate) fn join(self: &Arc<Self>, name: &str) -> Answer<Agent> {
        let mut list = self.list();
        let entry = list.get_mut(name).ok_or_else(|| unknown(name))?;
        if entry.joined {
            let message = "the world is joined already; it takes one client";
            return Err(Refusal::precondition(message));
        }
        entry.joined = true;
        Ok(Agent { world: Arc::clone(&entry.world), worlds: Arc::clone(self) })
    }

    fn leave(&self, world: &World) {
        let mut list = self.list();
        let Some(entry) = list.get_mut(&world.name) else { return };
        world.leave();
        (entry.joined, entry.waiting) = (false, false);
        let gone = (entry.orphan || world.broken()).then(|| list.remove(&world.name));
        drop(list);
        drop(gone);
    }

    /// Resets a world: at once, or, if an agent has joined it, at that agent's next step; the receiver
    /// then tells when. `own` is the world that the asking stream has joined: while it waits, its own
    /// world cannot be waited for, lest two wait for each other.
    pub(crate) fn reset(
        &self,
        name: &str,
        own: Option<&str>,
        next: NextReset,
    ) -> Answer<Option<oneshot::Receiver<()>>> {
        let mut list = self.list();
        let entry = list.get_mut(name).ok_or_else(|| unknown(name))?;
        if !entry.joined {
            entry.world.environment()?.reset(next);
            return Ok(None);
        }
        if entry.waiting {
            return Err(Refusal::precondition(
                "the world's client waits itself for the reset of a world: try again later",
            ));
        }
        let receiver = entry.world.reset_later(next);
        if let Some(own) = own.and_then(|own| list.get_mut(own)) {
            own.waiting = true;
        }
        Ok(Some(receiver))
    }

    /// The agent of this world waits no longer.
    pub(crate) fn waited(&self, name: &str) {
        if let Some(entry) = self.list().get_mut(name) {
            entry.waiting = false;
        }
    }

    /// Frees a world that nobody has joined.
    pub(crate) fn destroy(&self, name: &str) -> Answer<()> {
        let mut list = self.list();
        let entry = list.get(name).ok_or_else(|| unknown(name))?;
        if entry.joined {
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
        let mut list = self.list();
        let own = list.values_mut().filter(|entry| entry.owner == owner);
        own.for_each(|entry| entry.orphan = true);
        let gone: Vec<_> = list.extract_if(|_, entry| entry.orphan && !entry.joined).collect();
        drop(list);
        drop(gone);
    }
}
