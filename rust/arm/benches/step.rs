//! Cost of a physics step.
#![allow(missing_docs, clippy::unwrap_used)]

use criterion::{Criterion, criterion_group, criterion_main};
use octoarm_arm::{Actuator, Arm, ArmParameters};

fn step(criterion: &mut Criterion) {
    let mut arm = Arm::new(ArmParameters::default(), Actuator::Servo).unwrap();
    let mut count = 0_u32;
    criterion.bench_function("one arm, one step", |bench| {
        bench.iter(|| {
            count += 1;
            let angle = 20.0 * (f64::from(count) * 0.01).sin();
            arm.step([angle, 0.5 * angle]).unwrap();
        });
    });
}

criterion_group!(benches, step);
criterion_main!(benches);
