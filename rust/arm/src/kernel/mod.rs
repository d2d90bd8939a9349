//! The equations of motion in the shape that runs fast.
//!
//! Everything is computed in body frames, compartment by compartment, with the strut's joint split
//! into three elementary ones (prismatic along z, revolute about x, revolute about y), so that a
//! joint's inertia is a number and a change of frame a plane rotation. The work is split into passes,
//! each a straight line of arithmetic without data-dependent branches:
//!
//! | part | pass | runs | gives |
//! |---|---|---|---|
//! | [`outward`] | [`kinematics::angles`] | every compartment by itself | sines and cosines of α, β |
//! | | [`kinematics::outward`] | base to tip | velocities, and accelerations that would arise with q̈ = 0 |
//! | | [`water`] | by itself | gravity, buoyancy, drag, lift (Eqs. 9–15), volume |
//! | [`inward`] | [`springs`] | by itself | spring and volume forces (Eqs. 1–4, 7–8) |
//! | | [`plane`] | by itself | inertia and bias of a plane with its four joint masses (Eqs. 5–6) |
//! | | [`articulated::inward`] | tip to base | articulated-body inertias |
//! | [`accelerations`] | [`articulated::outward`] | base to tip | the accelerations q̈ |
//!
//! # Layout
//! Quantities are kept in rows of [`WIDTH`] slots. Slot `j · L + lane` of a body with `L` lanes holds
//! compartment `j` of arm `lane`: with `L = 1` a row holds eight neighbouring compartments of one
//! arm, with `L = WIDTH` one compartment of eight arms. Passes that treat compartments by themselves
//! do not see the difference; the three that walk along the arm are generic over `L`.
//!
//! # Order
//! What bounds the speed is not the number of operations but the waits in chains of dependent ones.
//! So passes that are one long chain are interleaved with work that is independent of them: the
//! inward sweep of a chunk with the springs of the next, the accelerations of a Runge–Kutta stage with
//! the velocities and water of the next stage, a few chunks at a time ([`STRETCH`]). The order of the
//! passes changes no bits. All that is written and read again is aligned to a cache line.
//!
//! # Bits
//! Fused multiply-adds are written out (the compiler contracts nothing by itself) and no function of
//! the platform's mathematical library is called, so the result is the same to the bit on every
//! machine and for every instruction set.

mod articulated;
mod body;
mod evaluation;
mod kinematics;
mod plane;
mod rows;
mod springs;
mod water;

pub(crate) use articulated::Travel as InertiaTravel;
pub(crate) use body::{Body, Material, Rest, lane_row, set_lane};
pub(crate) use evaluation::{STRETCH, Workspace, accelerations, inward, outward, spring_lengths};
pub(crate) use kinematics::{BaseFrame, Travel as MotionTravel};
pub(crate) use rows::{Block, Lengths, Muscles, Row, WIDTH, place};
