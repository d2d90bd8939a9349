//! A parameter that may differ from compartment to compartment.

use std::fmt;

use serde::Serialize;
use serde::de::value::SeqAccessDeserializer;
use serde::de::{Deserialize, Deserializer, SeqAccess, Visitor};

use crate::error::ParameterError;
use crate::interval::Interval;

/// A parameter of the compartments: one number for all, or one for each. In JSON a number or a list.
///
/// ```
/// use octoarm_arm::{ArmParameters, PerCompartment};
/// let mut parameters = ArmParameters { compartments: 3, ..ArmParameters::default() };
/// parameters.longitudinal_stiffness = vec![300.0, 200.0, 100.0].into();
/// parameters.validate()?;
/// assert_eq!(parameters.longitudinal_stiffness.at(2), 100.0);
/// assert_eq!(parameters.transverse_stiffness, PerCompartment::Same(1570.0));
/// # Ok::<(), octoarm_arm::ParameterError>(())
/// ```
#[derive(Clone, Debug, PartialEq, Serialize)]
#[serde(untagged)]
pub enum PerCompartment {
    /// The same number for every compartment.
    Same(f64),
    /// A number for each compartment, from base to tip; as many as [`crate::ArmParameters`] has
    /// `compartments`.
    Each(Vec<f64>),
}

impl PerCompartment {
    /// The number of a compartment, counted from 0 at the base.
    ///
    /// # Panics
    /// If there is a number for each compartment, but none for this one.
    #[must_use]
    pub fn at(&self, compartment: usize) -> f64 {
        match self {
            Self::Same(value) => *value,
            Self::Each(values) => values[compartment],
        }
    }

    /// Refuses a list of another length than `compartments`, and numbers outside a range.
    pub(crate) fn check(
        &self,
        name: &str,
        compartments: usize,
        range: Interval,
    ) -> Result<(), ParameterError> {
        let values = match self {
            Self::Same(value) => return range.check(*value, || name.to_owned()),
            Self::Each(values) => values,
        };
        if values.len() != compartments {
            let expected =
                format!("({compartments},), a number for each compartment, or one number");
            return Err(ParameterError::shape(name, format!("({},)", values.len()), expected));
        }
        let mut entries = values.iter().enumerate();
        entries.try_for_each(|(index, value)| range.check(*value, || format!("{name}[{index}]")))
    }
}

impl From<f64> for PerCompartment {
    fn from(value: f64) -> Self {
        Self::Same(value)
    }
}

impl From<Vec<f64>> for PerCompartment {
    fn from(values: Vec<f64>) -> Self {
        Self::Each(values)
    }
}

// By hand, since an untagged enumeration could say neither what it found nor where in the list.
impl<'de> Deserialize<'de> for PerCompartment {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        struct Number;

        impl<'de> Visitor<'de> for Number {
            type Value = PerCompartment;

            fn expecting(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
                formatter.write_str("a number, or a list with one for each compartment")
            }

            fn visit_f64<E>(self, value: f64) -> Result<Self::Value, E> {
                Ok(PerCompartment::Same(value))
            }

            fn visit_i64<E>(self, value: i64) -> Result<Self::Value, E> {
                Ok(PerCompartment::Same(value as f64))
            }

            fn visit_u64<E>(self, value: u64) -> Result<Self::Value, E> {
                Ok(PerCompartment::Same(value as f64))
            }

            fn visit_seq<A: SeqAccess<'de>>(self, list: A) -> Result<Self::Value, A::Error> {
                Vec::deserialize(SeqAccessDeserializer::new(list)).map(PerCompartment::Each)
            }
        }

        deserializer.deserialize_any(Number)
    }
}
