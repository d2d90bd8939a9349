//! The body's parameters: Table 1 of the paper and the quantities that the table leaves open.

use serde::{Deserialize, Serialize};

use crate::error::ParameterError;
use crate::interval::Interval;
use crate::json::read_json;
use crate::per_compartment::PerCompartment;

/// Which area Eqs. 12–13 multiply (the paper's `A_r`), before `area_scale`.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum ReferenceArea {
    /// Wetted lateral area, `π (R_b + R_t) h`.
    Wetted,
    /// Projected side area, `(R_b + R_t) h`.
    Planform,
}

/// Which forces the isovolumetric constraint of Eqs. 7–8 is proportional to.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum VolumeForce {
    /// As printed: `|δ_c|` in Eq. 7 and `|Σ (ξ_c + ξ_v) + F_ex·n|` in Eq. 8.
    Applied,
    /// The springs' own forces count too: `δ_c − K_r (r − r_0) − C_r ṙ` and
    /// `ξ_c − K_l (l − l_0) − C_l l̇`.
    Total,
}

/// How a turning base reaches the arm.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum BaseCoupling {
    /// The paper's: arm and water move in the frame of the base, whose rotation turns gravity only.
    /// The velocities of Eqs. 12–13, like ḧ, α̈ and β̈ of Eqs. 1–6, are relative to the base plane.
    Gravity,
    /// The base is accelerated in the world, and inertia and water feel all of it.
    Inertial,
}

/// Every parameter of the body, in SI units. Defaults are Table 1 of the paper with the readings
/// documented for each field; all are validated by [`ArmParameters::validate`].
///
/// A [`PerCompartment`] is one number for the whole arm, or a list of values from base to tip with one
/// for each compartment, which must be as many as `compartments`. Entry `j` is of the compartment `j`,
/// counted from 0: of its four longitudinal springs, and of the plane that is its ceiling with its four
/// transverse springs and joints. The base plane has no springs and no mass.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct ArmParameters {
    /// How a turning base reaches the arm, which the paper leaves open; by default
    /// [`BaseCoupling::Gravity`].
    pub base_coupling: BaseCoupling,
    /// Rest length `l_0` of every longitudinal spring \[m\], in (0, 10\] and longer than the taper
    /// from one plane to the next; by default 0.02 (Table 1).
    pub rest_length: f64,
    /// Radius `r_0` of the base plane, where the taper begins \[m\], in (0, 10\]; by default 0.015
    /// (Table 1).
    pub base_radius: f64,
    /// Rest radius of the last plane \[m\], in (0, 10\]; by default 0.0067 (Table 1). The planes
    /// between taper linearly.
    pub tip_radius: f64,
    /// Mass `M_l` of a longitudinal spring \[kg\], in (0, 100\]; by default 1.25e-3 (Table 1). The
    /// part `longitudinal_mass_share` of it moves with its upper joint.
    pub longitudinal_mass: PerCompartment,
    /// Mass `M_r` of a transverse spring, lumped at the same joint \[kg\], in \[0, 100\]; by
    /// default 1.25e-3 (Table 1).
    pub transverse_mass: PerCompartment,
    /// Part of `longitudinal_mass` that moves with the joint, from 1/3 (a rod that turns about its
    /// foot, Eq. 2) to 1 (all of it at the joint, Eqs. 1 and 3); by default 0.64 (docs/body.md).
    pub longitudinal_mass_share: f64,
    /// Damping `C_l` of a longitudinal spring \[N s/m\], in \[0, 1e6\]; by default 1 (Table 1).
    pub longitudinal_damping: PerCompartment,
    /// Damping `C_r` of a transverse spring \[N s/m\], in \[0, 1e6\]; by default 1 (Table 1).
    pub transverse_damping: PerCompartment,
    /// Stiffness `K_l` of a longitudinal spring \[N/m\], in (0, 1e9\]; by default 196 (Table 1).
    pub longitudinal_stiffness: PerCompartment,
    /// Stiffness `K_r` of a transverse spring \[N/m\], in (0, 1e9\]; by default 1570 (Table 1).
    pub transverse_stiffness: PerCompartment,
    /// Gain `K_lv` of the isovolumetric force on longitudinal springs, Eq. 7 \[1/m³\], in \[0,
    /// 1e12\]; by default 1e6 (Table 1).
    pub longitudinal_volume_gain: f64,
    /// Gain `K_rv` of the isovolumetric force on transverse springs, Eq. 8 \[1/m³\], in \[0,
    /// 1e12\]; by default 1e6 (Table 1).
    pub transverse_volume_gain: f64,
    /// Density `ρ_w` of the water \[kg/m³\], in \[0, 1e5\]; by default 1000 (Table 1). With 0 there
    /// is no water.
    pub water_density: f64,
    /// Density `ρ_o` of the arm \[kg/m³\], Eqs. 10–11, in \[0, 1e5\]; by default 1110
    /// (docs/body.md).
    pub arm_density: f64,
    /// Gravity in the world frame \[m/s²\], each entry in \[−1e3, 1e3\]; by default (0, 0, 9.81).
    /// The resting arm points along +z, so it hangs.
    pub gravity: [f64; 3],
    /// Factor on the reference area of Eqs. 12–13, in \[0, 1e4\]; by default 1.5 (docs/body.md).
    pub area_scale: f64,
    /// Area that `area_scale` multiplies; by default [`ReferenceArea::Wetted`].
    pub reference_area: ReferenceArea,
    /// Reading of Eqs. 7–8; by default [`VolumeForce::Applied`].
    pub volume_force: VolumeForce,
    /// Coefficients of Eq. 14, highest power first, of an angle in degrees, each in \[−1e3, 1e3\]
    /// and such that the drag is never below 0 from 0 to 90 degrees; by default the paper's.
    pub drag_coefficients: [f64; 5],
    /// Coefficients of Eq. 15, highest power first, of an angle in degrees, each in \[−1e3, 1e3\];
    /// by default the paper's.
    pub lift_coefficients: [f64; 5],
    /// Factor on the lift force, in \[−1e4, 1e4\]; by default 1, and 0 turns lift off. Eq. 13
    /// leaves its direction open: +1 is along the part of −v normal to the strut, as on a slender
    /// body in a cross-flow; −1 is the opposite.
    pub lift_scale: f64,
    /// Mass `M_ce` of a plane at its centre, beside its four joint masses \[kg\], in \[0, 100\]; by
    /// default 0.
    pub plane_mass: PerCompartment,
    /// Moment of inertia `I_ce` of a plane about its x and y axes, of which it has twice as much
    /// about z \[kg m²\], in \[0, 100\]; by default 0.
    pub plane_inertia: PerCompartment,
    /// Number of compartments, from 1 to [`ArmParameters::MAX_COMPARTMENTS`]; by default 20 (Table
    /// 1).
    pub compartments: usize,
    /// Step of the fourth-order Runge–Kutta method \[s\], in (0, 0.1\]; by default 1e-3 (Table 1).
    pub timestep: f64,
    /// Natural frequency of the critically damped base servo \[Hz\], in (0, 1e4\]; by default 12.
    pub servo_frequency: f64,
}

impl Default for ArmParameters {
    fn default() -> Self {
        Self::nakajima2013()
    }
}

impl ArmParameters {
    /// Largest number of compartments; the static equilibrium solves for seven unknowns each.
    pub const MAX_COMPARTMENTS: usize = 200;

    /// Names that [`ArmParameters::preset`] takes.
    pub const PRESETS: [&'static str; 2] = ["nakajima2013", "inertial"];

    /// A body by its name.
    ///
    /// # Errors
    /// [`ParameterError::OutOfRange`] for a name that is not one of [`ArmParameters::PRESETS`].
    pub fn preset(name: &str) -> Result<Self, ParameterError> {
        match name {
            "nakajima2013" => Ok(Self::nakajima2013()),
            "inertial" => Ok(Self::inertial()),
            _ => {
                let range = format!("of named bodies, {:?}", Self::PRESETS);
                Err(ParameterError::out_of_range("arm", format!("{name:?}"), range))
            }
        }
    }

    /// The paper's body: Table 1, and for what the table leaves open values with which the errors of
    /// Table 2 are at or below the paper's (docs/body.md).
    #[must_use]
    pub fn nakajima2013() -> Self {
        Self {
            base_coupling: BaseCoupling::Gravity,
            rest_length: 0.02,
            base_radius: 0.015,
            tip_radius: 0.0067,
            longitudinal_mass: PerCompartment::Same(1.25e-3),
            transverse_mass: PerCompartment::Same(1.25e-3),
            longitudinal_mass_share: 0.64,
            longitudinal_damping: PerCompartment::Same(1.0),
            transverse_damping: PerCompartment::Same(1.0),
            longitudinal_stiffness: PerCompartment::Same(196.0),
            transverse_stiffness: PerCompartment::Same(1570.0),
            longitudinal_volume_gain: 1e6,
            transverse_volume_gain: 1e6,
            water_density: 1000.0,
            arm_density: 1110.0,
            gravity: [0.0, 0.0, 9.81],
            area_scale: 1.5,
            reference_area: ReferenceArea::Wetted,
            volume_force: VolumeForce::Applied,
            drag_coefficients: [-5.5e-9, 6.3e-7, -7.7e-6, 0.0015, 0.017],
            lift_coefficients: [1.8e-9, -5.9e-7, 2.8e-5, 0.0011, 0.00089],
            lift_scale: 1.0,
            plane_mass: PerCompartment::Same(0.0),
            plane_inertia: PerCompartment::Same(0.0),
            compartments: 20,
            timestep: 1e-3,
            servo_frequency: 12.0,
        }
    }

    /// The arm in the world: the base carries it along. Natural numbers, not fitted to the paper: all
    /// masses at the joints, the wetted area itself, and the density that is all spring mass over the
    /// rest volume. Of the bodies tried it bears bang-bang commands of a servo best (docs/body.md).
    #[must_use]
    pub fn inertial() -> Self {
        Self {
            base_coupling: BaseCoupling::Inertial,
            longitudinal_mass_share: 1.0,
            area_scale: 1.0,
            arm_density: 1303.0,
            ..Self::nakajima2013()
        }
    }

    /// Checks every parameter.
    ///
    /// # Errors
    /// [`ParameterError`] with the name, value and allowed range of the first parameter found
    /// outside it (a NaN is outside every range).
    pub fn validate(&self) -> Result<(), ParameterError> {
        let (above, closed) = (Interval::above, Interval::closed);
        let scalars: [(&str, f64, Interval); 12] = [
            ("rest_length", self.rest_length, above(0.0, 10.0)),
            ("base_radius", self.base_radius, above(0.0, 10.0)),
            ("tip_radius", self.tip_radius, above(0.0, 10.0)),
            ("longitudinal_mass_share", self.longitudinal_mass_share, closed(1.0 / 3.0, 1.0)),
            ("longitudinal_volume_gain", self.longitudinal_volume_gain, closed(0.0, 1e12)),
            ("transverse_volume_gain", self.transverse_volume_gain, closed(0.0, 1e12)),
            ("water_density", self.water_density, closed(0.0, 1e5)),
            ("arm_density", self.arm_density, closed(0.0, 1e5)),
            ("area_scale", self.area_scale, closed(0.0, 1e4)),
            ("lift_scale", self.lift_scale, closed(-1e4, 1e4)),
            ("timestep", self.timestep, above(0.0, 0.1)),
            ("servo_frequency", self.servo_frequency, above(0.0, 1e4)),
        ];
        for (name, value, range) in scalars {
            range.check(value, || name.to_owned())?;
        }
        if !(1..=Self::MAX_COMPARTMENTS).contains(&self.compartments) {
            let range = format!("[1, {}]", Self::MAX_COMPARTMENTS);
            return Err(ParameterError::out_of_range("compartments", self.compartments, range));
        }
        for (name, values, range) in self.per_compartment() {
            values.check(name, self.compartments, range)?;
        }
        for (name, values) in [
            ("gravity", &self.gravity[..]),
            ("drag_coefficients", &self.drag_coefficients),
            ("lift_coefficients", &self.lift_coefficients),
        ] {
            for (index, value) in values.iter().enumerate() {
                Interval::within(1e3).check(*value, || format!("{name}[{index}]"))?;
            }
        }
        let step = self.radius_step().abs();
        if step >= self.rest_length {
            let range = format!("({step}, 10]: longer than the taper from one plane to the next");
            return Err(ParameterError::out_of_range("rest_length", self.rest_length, range));
        }
        self.check_drag()
    }

    /// A drag coefficient below zero would push the arm along: Eq. 14 must stay at or above zero
    /// on the whole range of incidence, 0 to 90 degrees.
    fn check_drag(&self) -> Result<(), ParameterError> {
        let drag = |angle: f64| self.drag_coefficients.iter().fold(0.0, |sum, e| sum * angle + e);
        // A quartic has at most two minima: a grid brackets each, thirds close in on it.
        let grid = |k: usize| k as f64 / 4.0;
        for k in 0..=360_usize {
            let (mut low, mut high) = (grid(k.saturating_sub(1)), grid((k + 1).min(360)));
            if drag(grid(k)) > drag(low).min(drag(high)) {
                continue;
            }
            for _ in 0..60 {
                let third = (high - low) / 3.0;
                if drag(low + third) < drag(high - third) {
                    high -= third;
                } else {
                    low += third;
                }
            }
            let angle = 0.5 * (low + high);
            let value = drag(angle).min(drag(grid(k)));
            if value < 0.0 {
                return Err(ParameterError::out_of_range(
                    "drag_coefficients",
                    format!(
                        "{:?} (Eq. 14 gives {value:.3e} at {angle:.2} degrees)",
                        self.drag_coefficients
                    ),
                    "of polynomials at or above 0 from 0 to 90 degrees",
                ));
            }
        }
        Ok(())
    }

    /// Parameters from JSON text; fields left out take their defaults.
    ///
    /// # Errors
    /// [`ParameterError::Format`] for text that is not JSON of the right shape (an unknown field is
    /// named), [`ParameterError::OutOfRange`] as [`ArmParameters::validate`].
    pub fn from_json(text: &str) -> Result<Self, ParameterError> {
        let parameters: Self = read_json(text)?;
        parameters.validate()?;
        Ok(parameters)
    }

    /// The parameters as JSON text; [`ArmParameters::from_json`] gives them back bit for bit.
    ///
    /// # Errors
    /// [`ParameterError::Format`] if a value has no JSON form (only possible before validation).
    pub fn to_json(&self) -> Result<String, ParameterError> {
        serde_json::to_string_pretty(self)
            .map_err(|error| ParameterError::Format(error.to_string()))
    }

    /// Change of rest radius from one plane to the next \[m\], negative for an arm that tapers.
    #[must_use]
    pub fn radius_step(&self) -> f64 {
        (self.tip_radius - self.base_radius) / self.compartments as f64
    }

    /// Rest radius of plane `plane` (0 is the base) \[m\].
    #[must_use]
    pub fn rest_radius(&self, plane: usize) -> f64 {
        self.base_radius + self.radius_step() * plane as f64
    }

    /// Rest height of every strut \[m\]: with it each longitudinal spring has its rest length.
    #[must_use]
    pub fn rest_height(&self) -> f64 {
        let step = self.radius_step();
        (self.rest_length * self.rest_length - step * step).sqrt()
    }

    /// Rest volume `V_0` of compartment `compartment` (counted from 0) \[m³\].
    #[must_use]
    pub fn rest_volume(&self, compartment: usize) -> f64 {
        frustum_volume(
            self.rest_radius(compartment),
            self.rest_radius(compartment + 1),
            self.rest_height(),
        )
    }

    /// Mass that moves with each joint of a compartment's ceiling (compartments are counted from 0),
    /// `M_r` and the share of `M_l` \[kg\].
    #[must_use]
    pub fn joint_mass(&self, compartment: usize) -> f64 {
        self.longitudinal_mass_share * self.longitudinal_mass.at(compartment)
            + self.transverse_mass.at(compartment)
    }

    /// The parameters that may differ from compartment to compartment: name, value and range.
    #[must_use]
    pub fn per_compartment(&self) -> [(&'static str, &PerCompartment, Interval); 8] {
        let (above, closed) = (Interval::above, Interval::closed);
        [
            ("longitudinal_mass", &self.longitudinal_mass, above(0.0, 100.0)),
            ("transverse_mass", &self.transverse_mass, closed(0.0, 100.0)),
            ("longitudinal_damping", &self.longitudinal_damping, closed(0.0, 1e6)),
            ("transverse_damping", &self.transverse_damping, closed(0.0, 1e6)),
            ("longitudinal_stiffness", &self.longitudinal_stiffness, above(0.0, 1e9)),
            ("transverse_stiffness", &self.transverse_stiffness, above(0.0, 1e9)),
            ("plane_mass", &self.plane_mass, closed(0.0, 100.0)),
            ("plane_inertia", &self.plane_inertia, closed(0.0, 100.0)),
        ]
    }
}

/// Volume of a circular truncated cone, `π h / 3 (R_b² + R_b R_t + R_t²)` \[m³\].
pub(crate) fn frustum_volume(floor_radius: f64, ceiling_radius: f64, height: f64) -> f64 {
    std::f64::consts::PI / 3.0
        * height
        * (floor_radius * floor_radius
            + floor_radius * ceiling_radius
            + ceiling_radius * ceiling_radius)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn default_volumes_are_table_1() {
        let parameters = ArmParameters::default();
        // Table 1 prints three digits: 1.38e-5 and 2.99e-6.
        assert!((parameters.rest_volume(0) / 1.38e-5 - 1.0).abs() < 0.004);
        assert!((parameters.rest_volume(19) / 2.99e-6 - 1.0).abs() < 0.004);
    }

    #[test]
    fn errors_name_the_parameter_the_value_and_the_range() {
        let parameters = ArmParameters { longitudinal_mass: (-1.0).into(), ..Default::default() };
        let message = parameters.validate().expect_err("negative mass").to_string();
        assert_eq!(message, "longitudinal_mass = -1 is outside the allowed range (0, 100]");
        for bad in [f64::NAN, f64::INFINITY] {
            let parameters = ArmParameters { timestep: bad, ..Default::default() };
            assert!(parameters.validate().is_err());
        }
        let parameters =
            ArmParameters { drag_coefficients: [0.0, 0.0, 0.0, -1.0, 0.5], ..Default::default() };
        assert!(
            parameters.validate().expect_err("thrust").to_string().contains("drag_coefficients")
        );
    }

    #[test]
    fn json_round_trip_is_exact_and_unknown_fields_are_named() {
        let parameters = ArmParameters { arm_density: 1.0 / 3.0 * 4000.0, ..Default::default() };
        let text = parameters.to_json().expect("json");
        assert_eq!(ArmParameters::from_json(&text).expect("parse"), parameters);
        let message =
            ArmParameters::from_json(r#"{"stiffness": 3}"#).expect_err("unknown").to_string();
        assert!(message.contains("stiffness"), "{message}");
    }
}
