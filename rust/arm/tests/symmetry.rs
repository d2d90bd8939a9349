//! What looks the same in a mirror, or turned by a right angle, moves the same.
#![allow(missing_docs, clippy::unwrap_used, clippy::panic)]

use octoarm_arm::{Actuator, Arm, ArmParameters, VolumeForce};

/// Rounding alone: mirrored arms add the same numbers in another order. 2.4e-17 m was the most
/// measured, and the arm forgets a disturbance, so that this does not grow with time.
const TOLERANCE: f64 = 1e-15;
const STEPS: u32 = 1000;

/// An image of the arm: where it takes a base command and every spring of a compartment.
struct Image {
    name: &'static str,
    command: fn([f64; 2]) -> [f64; 2],
    /// Spring `i` of the arm is spring `springs[i]` of the image.
    springs: [usize; 4],
}

/// y → −y turns rotations about x round and keeps those about y.
const MIRROR_Y: Image =
    Image { name: "y → −y", command: |[theta, phi]| [-theta, phi], springs: [0, 3, 2, 1] };
const MIRROR_X: Image =
    Image { name: "x → −x", command: |[theta, phi]| [theta, -phi], springs: [2, 1, 0, 3] };
/// Only for motion about one axis: a universal joint bends about x first, then about y. A mirror
/// turns the sense of rotation, so θ about x becomes −φ about y.
const SWAP: Image =
    Image { name: "x ↔ y", command: |[theta, phi]| [-phi, -theta], springs: [1, 0, 3, 2] };
/// A quarter turn about z, x → y → −x, is no mirror: θ about x becomes φ about y.
const QUARTER_TURN: Image =
    Image { name: "quarter turn", command: |[theta, phi]| [-phi, theta], springs: [1, 2, 3, 0] };

fn swing(step: u32) -> [f64; 2] {
    let t = f64::from(step) * 1e-3;
    [30.0 * (9.0 * t).sin(), 20.0 * (7.0 * t).sin() + 5.0 * (23.0 * t).sin()]
}

/// Compares an arm and its image, both driven; `drive` says which axes move.
fn compare(parameters: &ArmParameters, image: &Image, drive: [f64; 2]) -> f64 {
    let mut arm = Arm::new(parameters.clone(), Actuator::Servo).unwrap();
    let mut mirrored = arm.clone();
    // Muscles of unlike strength, so that no spring passes for another by chance.
    let count = arm.observation_len();
    let push: Vec<f64> = (0..count).map(|i| 0.05 * (1.7 * i as f64).sin()).collect();
    let spread: Vec<f64> = (0..count).map(|i| 0.05 * (2.3 * i as f64).cos()).collect();
    let image_of = |values: &[f64]| {
        let mut moved = vec![0.0; count];
        for (index, value) in values.iter().enumerate() {
            moved[4 * (index / 4) + image.springs[index % 4]] = *value;
        }
        moved
    };
    if drive[0] != 0.0 && drive[1] != 0.0 {
        arm.set_muscles(&push, &spread).unwrap();
        mirrored.set_muscles(&image_of(&push), &image_of(&spread)).unwrap();
    }
    let mut worst = 0.0_f64;
    let mut range = (f64::INFINITY, 0.0_f64);
    for step in 0..STEPS {
        let [theta, phi] = swing(step);
        let command = [drive[0] * theta, drive[1] * phi];
        arm.step(command).unwrap();
        mirrored.step((image.command)(command)).unwrap();
        let lengths = arm.lengths();
        for (one, two) in image_of(&lengths).iter().zip(&mirrored.lengths()) {
            worst = worst.max((one - two).abs());
            range = (range.0.min(*one), range.1.max(*one));
        }
    }
    // Two arms that hang still would agree too.
    assert!(range.1 - range.0 > 2e-3, "the arm moved by {range:?} m");
    worst
}

fn bodies() -> [ArmParameters; 3] {
    let hanging = ArmParameters { arm_density: 1303.0, ..ArmParameters::default() };
    let carried = ArmParameters::inertial();
    let total = ArmParameters {
        volume_force: VolumeForce::Total,
        plane_mass: 0.01.into(),
        plane_inertia: 1e-6.into(),
        area_scale: 10.0,
        ..carried.clone()
    };
    [hanging, carried, total]
}

#[test]
fn mirrors_of_the_base_motion_are_mirrors_of_the_springs() {
    for parameters in bodies() {
        for image in [MIRROR_Y, MIRROR_X] {
            let worst = compare(&parameters, &image, [1.0, 1.0]);
            assert!(worst < TOLERANCE, "{}: {worst:e} m", image.name);
        }
    }
}

#[test]
fn the_axes_can_be_exchanged() {
    for parameters in bodies() {
        for image in [SWAP, QUARTER_TURN] {
            for drive in [[1.0, 0.0], [0.0, 1.0]] {
                let worst = compare(&parameters, &image, drive);
                assert!(worst < TOLERANCE, "{}, {drive:?}: {worst:e} m", image.name);
            }
        }
    }
}

#[test]
fn a_swing_about_one_axis_stays_in_its_plane() {
    for parameters in bodies() {
        let mut about_x = Arm::undeformed(parameters, Actuator::Servo).unwrap();
        let mut about_y = about_x.clone();
        let (mut bend, mut skew, mut swung) = (0.0_f64, 0.0_f64, 0.0_f64);
        for step in 0..STEPS {
            let [angle, _] = swing(step);
            about_x.step([angle, 0.0]).unwrap();
            about_y.step([0.0, angle]).unwrap();
            for q in &about_x.state().coordinates {
                bend = bend.max(q[2].abs());
                skew = skew.max((q[3] - q[5]).abs());
                swung = swung.max(q[1].abs());
            }
            for q in &about_y.state().coordinates {
                bend = bend.max(q[1].abs());
                skew = skew.max((q[4] - q[6]).abs());
            }
        }
        // Not zero to the bit: a fused r3 q3 − (r1 q1) leaves the rounding of one product. Measured:
        // 5e-14 rad out of the plane, 9e-17 m between the radii, with the heaviest planes.
        assert!(bend < 1e-12 && skew < 1e-15, "{bend:e} rad, {skew:e} m while {swung} rad");
        assert!(swung > 0.05, "{swung} rad");
    }
}

#[test]
fn only_the_angle_between_base_and_gravity_counts() {
    // Tilting the base by R_0 = R_x(θ) R_y(φ) and gravity by the same rotation changes nothing.
    let (theta, phi) = (0.4_f64, -0.7_f64);
    let upright = [1.0, -2.0, 9.0];
    let [x, y, z] = upright;
    let (x, z) = (phi.cos() * x + phi.sin() * z, phi.cos() * z - phi.sin() * x);
    let (y, z) = (theta.cos() * y - theta.sin() * z, theta.sin() * y + theta.cos() * z);
    let mut arm = Arm::undeformed(
        ArmParameters { gravity: upright, ..ArmParameters::default() },
        Actuator::Direct,
    )
    .unwrap();
    let mut tilted = Arm::undeformed(
        ArmParameters { gravity: [x, y, z], ..ArmParameters::default() },
        Actuator::Direct,
    )
    .unwrap();
    let mut state = tilted.state();
    state.base = [theta, phi, 0.0, 0.0];
    tilted.set_state(&state).unwrap();
    let command = tilted.base_degrees();
    let mut worst = 0.0_f64;
    for _ in 0..STEPS {
        arm.step([0.0; 2]).unwrap();
        tilted.step(command).unwrap();
        for (one, two) in arm.lengths().iter().zip(&tilted.lengths()) {
            worst = worst.max((one - two).abs());
        }
    }
    assert!(worst < TOLERANCE, "{worst:e} m");
}
