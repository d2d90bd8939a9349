//! What an evaluation reads and does not change: the body's parameters, in rows.

use super::rows::{Block, Row, WIDTH, place};
use crate::parameters::{ArmParameters, ReferenceArea, VolumeForce};
use crate::per_compartment::PerCompartment;

/// Parameters of the compartments of a chunk, one row each: those of all chunks, where no arm has lists
/// with a number for each compartment.
#[derive(Clone, Debug)]
#[repr(C, align(64))]
pub(crate) struct Material {
    pub(crate) rest_length: Row,
    pub(crate) longitudinal_stiffness: Row,
    pub(crate) longitudinal_damping: Row,
    pub(crate) transverse_stiffness: Row,
    pub(crate) transverse_damping: Row,
    pub(crate) longitudinal_volume_gain: Row,
    pub(crate) transverse_volume_gain: Row,
    /// 1 for [`VolumeForce::Total`], else 0.
    pub(crate) total: Row,
    /// 1 − `total`.
    pub(crate) applied: Row,
    pub(crate) joint_mass: Row,
    pub(crate) inverse_joint_mass: Row,
    pub(crate) plane_mass: Row,
    pub(crate) plane_inertia: Row,
    /// `ρ_o − ρ_w`, Eq. 10.
    pub(crate) net_density: Row,
    /// `½ ρ_w A_r / ((R_b + R_t) h)`.
    pub(crate) pressure_area: Row,
    pub(crate) lift_scale: Row,
    pub(crate) drag_coefficients: [Row; 5],
    pub(crate) lift_coefficients: [Row; 5],
}

/// All rows of a material, by reference.
macro_rules! rows_of {
    ($material:expr) => {{
        let Self {
            rest_length,
            longitudinal_stiffness,
            longitudinal_damping,
            transverse_stiffness,
            transverse_damping,
            longitudinal_volume_gain,
            transverse_volume_gain,
            total,
            applied,
            joint_mass,
            inverse_joint_mass,
            plane_mass,
            plane_inertia,
            net_density,
            pressure_area,
            lift_scale,
            drag_coefficients: [d0, d1, d2, d3, d4],
            lift_coefficients: [l0, l1, l2, l3, l4],
        } = $material;
        [
            rest_length,
            longitudinal_stiffness,
            longitudinal_damping,
            transverse_stiffness,
            transverse_damping,
            longitudinal_volume_gain,
            transverse_volume_gain,
            total,
            applied,
            joint_mass,
            inverse_joint_mass,
            plane_mass,
            plane_inertia,
            net_density,
            pressure_area,
            lift_scale,
            d0,
            d1,
            d2,
            d3,
            d4,
            l0,
            l1,
            l2,
            l3,
            l4,
        ]
    }};
}

impl Material {
    /// The rows of `L` arms: slot `k` belongs to arm `k % L`, and `compartment` says to which of its
    /// compartments.
    fn new<const L: usize>(
        arms: &[&ArmParameters; L],
        compartment: impl Fn(usize) -> usize,
    ) -> Self {
        let row = |value: fn(&ArmParameters) -> f64| lane_row::<L>(arms, value);
        let each = |value: &dyn Fn(&ArmParameters, usize) -> f64| -> Row {
            std::array::from_fn(|slot| value(arms[slot % L], compartment(slot)))
        };
        let listed = |values: fn(&ArmParameters) -> &PerCompartment| {
            each(&|arm, compartment| values(arm).at(compartment))
        };
        let coefficients = |values: fn(&ArmParameters) -> &[f64; 5]| {
            std::array::from_fn(|term| std::array::from_fn(|slot| values(arms[slot % L])[term]))
        };
        Self {
            rest_length: row(|arm| arm.rest_length),
            longitudinal_stiffness: listed(|arm| &arm.longitudinal_stiffness),
            longitudinal_damping: listed(|arm| &arm.longitudinal_damping),
            transverse_stiffness: listed(|arm| &arm.transverse_stiffness),
            transverse_damping: listed(|arm| &arm.transverse_damping),
            longitudinal_volume_gain: row(|arm| arm.longitudinal_volume_gain),
            transverse_volume_gain: row(|arm| arm.transverse_volume_gain),
            total: row(total_share),
            applied: row(|arm| 1.0 - total_share(arm)),
            joint_mass: each(&ArmParameters::joint_mass),
            inverse_joint_mass: each(&|arm, compartment| 1.0 / arm.joint_mass(compartment)),
            plane_mass: listed(|arm| &arm.plane_mass),
            plane_inertia: listed(|arm| &arm.plane_inertia),
            net_density: row(|arm| arm.arm_density - arm.water_density),
            pressure_area: row(|arm| {
                let shape = match arm.reference_area {
                    ReferenceArea::Wetted => std::f64::consts::PI,
                    ReferenceArea::Planform => 1.0,
                };
                0.5 * arm.water_density * arm.area_scale * shape
            }),
            lift_scale: row(|arm| arm.lift_scale),
            drag_coefficients: coefficients(|arm| &arm.drag_coefficients),
            lift_coefficients: coefficients(|arm| &arm.lift_coefficients),
        }
    }

    /// The materials of so many chunks: one for all of them, unless an arm has lists with a number for
    /// each compartment.
    fn of_chunks<const L: usize>(
        arms: &[&ArmParameters; L],
        chunks: usize,
        lists: bool,
        compartment: impl Fn(usize, usize) -> usize,
    ) -> Vec<Self> {
        let materials = if lists { chunks } else { 1 };
        (0..materials).map(|chunk| Self::new(arms, |slot| compartment(chunk, slot))).collect()
    }

    /// Gives a slot what an arm alone has in one of its slots.
    fn set_slot(&mut self, slot: usize, alone: &Self, at: usize) {
        for (row, alone) in rows_of!(self).into_iter().zip(rows_of!(alone)) {
            row[slot] = alone[at];
        }
    }
}

/// Gives the slots of one of `L` lanes what an arm alone has in all of them.
pub(crate) fn set_lane<const L: usize>(row: &mut Row, lane: usize, alone: &Row) {
    for slot in row.iter_mut().skip(lane).step_by(L) {
        *slot = alone[0];
    }
}

/// A parameter of `L` arms as a row: slot `k` belongs to arm `k % L`.
pub(crate) fn lane_row<const L: usize>(
    arms: &[&ArmParameters; L],
    value: fn(&ArmParameters) -> f64,
) -> Row {
    std::array::from_fn(|slot| value(arms[slot % L]))
}

fn total_share(parameters: &ArmParameters) -> f64 {
    match parameters.volume_force {
        VolumeForce::Applied => 0.0,
        VolumeForce::Total => 1.0,
    }
}

/// What differs from compartment to compartment and does not move.
#[derive(Clone, Debug)]
#[repr(C, align(64))]
pub(crate) struct Rest {
    /// Rest radius of the ceiling plane.
    pub(crate) radius: Row,
    /// Rest volume.
    pub(crate) volume: Row,
}

/// What an evaluation reads and does not change.
#[derive(Clone, Debug)]
pub(crate) struct Body<const L: usize> {
    pub(crate) compartments: usize,
    /// A chunk that ends with the base planes, as if they were compartments of their own.
    pub(crate) base: Box<Block>,
    /// On the heap, like all that asks for 64-byte alignment: an [`crate::Arm`] may be embedded in
    /// memory that a foreign allocator aligned for ordinary numbers only.
    materials: Vec<Material>,
    /// Whether there is a material for each chunk, since an arm has lists.
    lists: bool,
    pub(crate) rest: Vec<Rest>,
}

impl<const L: usize> Body<L> {
    /// The body of arms with so many compartments; `rest` of each chunk, and `compartment` says which
    /// compartment stands in a slot of a chunk.
    pub(crate) fn new(
        arms: &[&ArmParameters; L],
        base: Block,
        rest: Vec<Rest>,
        compartment: impl Fn(usize, usize) -> usize,
    ) -> Self {
        let lists = arms
            .iter()
            .flat_map(|arm| arm.per_compartment())
            .any(|(_, value, _)| matches!(value, PerCompartment::Each(_)));
        let materials = Material::of_chunks(arms, rest.len(), lists, compartment);
        Self { compartments: arms[0].compartments, base: Box::new(base), materials, lists, rest }
    }

    /// The material of a chunk.
    #[inline(always)]
    pub(crate) fn material(&self, chunk: usize) -> &Material {
        // One for all, mostly: it stays in the fastest cache.
        &self.materials[if self.lists { chunk } else { 0 }]
    }

    /// Gives a lane the body of an arm alone, with as many compartments.
    pub(crate) fn set_lane(&mut self, lane: usize, alone: &Body<1>) {
        for (row, alone) in self.base.0.iter_mut().zip(&alone.base.0) {
            set_lane::<L>(row, lane, alone);
        }
        if alone.lists && !self.lists {
            self.lists = true;
            self.materials.resize(self.rest.len(), self.materials[0].clone());
        }
        for (chunk, rest) in self.rest.iter_mut().enumerate() {
            for slot in (lane..WIDTH).step_by(L) {
                // Slots beyond the tip hold a compartment like the last.
                let compartment = ((chunk * WIDTH + slot) / L).min(self.compartments - 1);
                let (from, at) = place::<1>(compartment);
                rest.radius[slot] = alone.rest[from].radius[at];
                rest.volume[slot] = alone.rest[from].volume[at];
                if let Some(material) = self.materials.get_mut(chunk) {
                    material.set_slot(slot, alone.material(from), at);
                }
            }
        }
    }
}
