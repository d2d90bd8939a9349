//! What the resets take.

use std::collections::BTreeMap;

use octoarm_env::{Reach, Task};
use octoarm_protocol::Tensor;
use serde_json::Value;

use crate::reply::{Answer, Refusal, quoted};
use crate::task_settings::TaskName;
use crate::tensor::{doubles_of, to_json};

/// What starts the generators of phases anew.
#[derive(Clone, Debug, PartialEq)]
pub(crate) enum Seed {
    /// Episode i of a batch takes this number + i.
    First(u64),
    /// An entry an episode of a batch; without a number its generator goes on.
    Each(Vec<Option<u64>>),
}

impl Seed {
    /// The seed of an episode.
    pub(crate) fn of(&self, index: usize) -> Option<u64> {
        match self {
            Self::First(seed) => Some(seed.wrapping_add(index as u64)),
            Self::Each(seeds) => seeds.get(index).copied().flatten(),
        }
    }
}

/// How the next episode begins.
#[derive(Clone, Debug, Default, PartialEq)]
pub(crate) struct NextReset {
    /// Starts the generators of phases anew.
    pub(crate) seed: Option<Seed>,
    /// Where on the target, in turns from 0 to 1; without one it is drawn.
    pub(crate) phase: Option<f64>,
    /// Where the tips are to be brought \[m\]; without one it is drawn.
    pub(crate) goal: Option<[f64; 3]>,
    /// Which episodes of a batch begin anew; without it, all.
    pub(crate) mask: Option<Vec<bool>>,
}

/// A whole number from `low` to `high`.
pub(crate) fn whole(name: &str, value: &Value, low: i64, high: u64, range: &str) -> Answer<i128> {
    let number = value.as_i64().map(i128::from).or(value.as_u64().map(i128::from));
    number
        .filter(|number| (i128::from(low)..=i128::from(high)).contains(number))
        .ok_or_else(|| Refusal::out_of_range(name, value, range))
}

pub(crate) fn seed(value: &Value) -> Answer<u64> {
    Ok(whole("seed", value, 0, u64::MAX, "[0, 2^64) of whole numbers")? as u64)
}

/// A flag for each of so many episodes.
fn flags(name: &str, value: &Value, count: usize) -> Answer<Vec<bool>> {
    let flags: Option<Vec<bool>> =
        value.as_array().and_then(|flags| flags.iter().map(Value::as_bool).collect());
    flags.filter(|flags| flags.len() == count).ok_or_else(|| {
        Refusal::invalid(format!("{name}: expected {count} (num_envs) booleans, shape ({count})"))
    })
}

/// A seed, or one for each of so many episodes, of which a mask may take some.
fn reset_seed(value: &Value, mask: Option<&Value>, count: Option<usize>) -> Answer<Seed> {
    let (Value::Array(seeds), Some(count)) = (value, count) else {
        return match mask {
            None => Ok(Seed::First(seed(value)?)),
            Some(_) => Err(Refusal::invalid("seed_mask goes with a seed for each of num_envs")),
        };
    };
    if seeds.len() != count {
        let message = format!("seed has {} entries, expected {count} (num_envs)", seeds.len());
        return Err(Refusal::invalid(message));
    }
    let mask = mask.map_or(Ok(vec![true; count]), |mask| flags("seed_mask", mask, count))?;
    let each = seeds.iter().zip(mask);
    Ok(Seed::Each(
        each.map(|(one, taken)| taken.then(|| seed(one)).transpose()).collect::<Answer<_>>()?,
    ))
}

impl NextReset {
    /// Reads and checks the settings of a reset of a world of this task, by the agent of a batch of so many
    /// episodes if it is one.
    pub(crate) fn from_tensors(
        tensors: &BTreeMap<String, Tensor>,
        task: TaskName,
        num_envs: Option<usize>,
    ) -> Answer<Self> {
        let begin = match task {
            TaskName::LimitCycle => "phase",
            TaskName::Reach => "goal",
        };
        let known: &[&str] = match num_envs {
            None => &[begin, "seed"],
            Some(_) => &[begin, "reset_mask", "seed", "seed_mask"],
        };
        if let Some(name) = tensors.keys().find(|name| !known.contains(&name.as_str())) {
            let known = known.join(", ");
            return Err(Refusal::invalid(format!(
                "unknown setting {}; known are {known}",
                quoted(name)
            )));
        }
        let most = num_envs.unwrap_or(1);
        let value =
            |name: &str| tensors.get(name).map(|tensor| to_json(name, tensor, most)).transpose();
        let phase = |value: Value| match value.as_f64() {
            Some(phase) if (0.0..=1.0).contains(&phase) => Ok(phase),
            _ => Err(Refusal::out_of_range("phase", value, "[0, 1] turns")),
        };
        let seed_mask = value("seed_mask")?;
        let seed = match (value("seed")?, seed_mask.as_ref()) {
            (None, None) => None,
            (None, Some(_)) => return Err(Refusal::invalid("seed_mask needs a seed")),
            (Some(seed), mask) => Some(reset_seed(&seed, mask, num_envs)?),
        };
        let mask = match (value("reset_mask")?, num_envs) {
            (Some(mask), Some(count)) => Some(flags("reset_mask", &mask, count)?),
            _ => None,
        };
        let goal =
            tensors.get("goal").map(|tensor| doubles_of("goal", tensor, &[3])).transpose()?;
        let goal = goal.and_then(|goal| goal.as_chunks().0.first().copied());
        goal.map_or(Ok(()), Reach::check_ask)?;
        Ok(Self { seed, phase: value("phase")?.map(phase).transpose()?, goal, mask })
    }

    /// What is asked for later goes before what was asked for earlier, and what was to begin anew
    /// still does; `asked` tells whether anything was asked for.
    pub(crate) fn overlay(&mut self, later: Self, asked: bool) {
        self.seed = later.seed.or(self.seed.take());
        self.phase = later.phase.or(self.phase);
        self.goal = later.goal.or(self.goal);
        self.mask = match (self.mask.take(), later.mask) {
            (_, None) => None,
            (None, Some(later)) => (!asked).then_some(later),
            (Some(earlier), Some(later)) => {
                Some(earlier.into_iter().zip(later).map(|(one, other)| one || other).collect())
            }
        };
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::tensor::{bools, doubles, integer, text};

    #[test]
    fn resets_take_a_seed_and_a_phase() {
        let read = |name: &str, tensor: Tensor| {
            let tensors = BTreeMap::from([(name.to_owned(), tensor)]);
            NextReset::from_tensors(&tensors, TaskName::LimitCycle, None)
        };
        let next = read("phase", doubles(vec![0.25], &[])).expect("phase");
        assert_eq!(next, NextReset { phase: Some(0.25), ..NextReset::default() });
        assert_eq!(read("seed", integer(3)).map(|next| next.seed), Ok(Some(Seed::First(3))));
        assert!(
            read("phase", doubles(vec![1.5], &[]))
                .expect_err("bad")
                .message
                .contains("phase = 1.5")
        );
        assert!(read("amplitude", integer(3)).expect_err("bad").message.contains("amplitude"));
        for (name, tensor, expected) in [
            ("seed", integer(-1), "seed = -1 is outside the allowed range [0, 2^64)"),
            ("phase", text("half"), "phase = \"half\" is outside the allowed range [0, 1] turns"),
        ] {
            assert!(read(name, tensor).expect_err(name).message.contains(expected));
        }
        let seed = |seed: u64| Some(Seed::First(seed));
        let half = NextReset { phase: Some(0.5), ..NextReset::default() };
        let mut first = NextReset { seed: seed(1), ..half.clone() };
        first.overlay(NextReset { seed: seed(2), ..NextReset::default() }, true);
        assert_eq!(first, NextReset { seed: seed(2), ..half });
    }

    #[test]
    fn resets_of_a_batch_take_masks() {
        let read = |pairs: &[(&str, Tensor)]| {
            let pairs = pairs.iter().map(|(name, tensor)| ((*name).to_owned(), tensor.clone()));
            NextReset::from_tensors(&pairs.collect(), TaskName::LimitCycle, Some(3))
        };
        let mask = |flags: [bool; 3]| bools(flags.to_vec(), &[3]);
        let seeds = Tensor { payload: doubles(vec![5.0, 6.0, 7.0], &[3]).payload, shape: vec![3] };
        let next = read(&[
            ("seed", seeds.clone()),
            ("seed_mask", mask([true, false, true])),
            ("reset_mask", mask([false, true, true])),
        ]);
        let expected = NextReset {
            seed: Some(Seed::Each(vec![Some(5), None, Some(7)])),
            mask: Some(vec![false, true, true]),
            ..NextReset::default()
        };
        assert_eq!(next, Ok(expected));
        for (pairs, message) in [
            (&[("seed", doubles(vec![1.0; 2], &[2]))][..], "seed has 2 entries, expected 3"),
            (&[("seed_mask", mask([true; 3]))], "seed_mask needs a seed"),
            (&[("seed", integer(1)), ("seed_mask", mask([true; 3]))], "seed_mask goes with"),
            (&[("reset_mask", bools(vec![true; 2], &[2]))], "reset_mask: expected 3 (num_envs)"),
            (&[("reset_mask", doubles(vec![1.0; 3], &[3]))], "reset_mask: expected 3 (num_envs)"),
            (&[("mask", mask([true; 3]))], "known are phase, reset_mask, seed, seed_mask"),
        ] {
            let found = read(pairs).expect_err(message).message;
            assert!(found.contains(message), "{found}");
        }

        let masked =
            |flags: [bool; 3]| NextReset { mask: Some(flags.to_vec()), ..NextReset::default() };
        let mut next = NextReset::default();
        next.overlay(masked([true, false, false]), false);
        next.overlay(masked([false, true, false]), true);
        assert_eq!(next.mask, Some(vec![true, true, false]));
        next.overlay(NextReset::default(), true);
        next.overlay(masked([false, true, false]), true);
        assert_eq!(next.mask, None);
    }

    #[test]
    fn resets_of_reaching_take_a_goal() {
        let read = |name: &str, tensor: Tensor| {
            let tensors = BTreeMap::from([(name.to_owned(), tensor)]);
            NextReset::from_tensors(&tensors, TaskName::Reach, None)
        };
        let goal = [0.1, -0.2, 1.0 / 3.0];
        let next = read("goal", doubles(goal.to_vec(), &[3])).expect("goal");
        assert_eq!(next, NextReset { goal: Some(goal), ..NextReset::default() });
        for (name, tensor, expected) in [
            (
                "goal",
                doubles(vec![0.0, 11.0, 0.0], &[3]),
                "goal[1] = 11 is outside the allowed range",
            ),
            ("goal", doubles(vec![0.0, f64::NAN, 0.0], &[3]), "goal[1] = NaN"),
            ("goal", doubles(vec![0.0; 2], &[2]), "goal has shape [2], expected [3]"),
            ("goal", integer(1), "goal has elements of type INT64, expected DOUBLE"),
            ("phase", doubles(vec![0.5], &[]), "unknown setting \"phase\"; known are goal, seed"),
        ] {
            let message = read(name, tensor).expect_err(expected).message;
            assert!(message.contains(expected), "{message}");
        }
    }
}
