//! Cost of a physics step: of one arm, and of eight in lanes, with each instruction set.
#![allow(missing_docs, clippy::unwrap_used)]

use criterion::{Criterion, Throughput, criterion_group, criterion_main};
use octoarm_arm::{Actuator, Arm, ArmLanes, ArmParameters, InstructionSet};

fn command(count: u32) -> [f64; 2] {
    let angle = 20.0 * (f64::from(count) * 0.01).sin();
    [angle, 0.5 * angle]
}

fn step(criterion: &mut Criterion) {
    let arm = Arm::new(ArmParameters::default(), Actuator::Servo).unwrap();
    // The baseline without fused multiply-add takes a hundred times as long; it has the same bits.
    for set in [InstructionSet::Baseline, InstructionSet::Avx2, InstructionSet::Avx512] {
        if set > InstructionSet::best() {
            continue;
        }
        let arm = arm.clone().with_instruction_set(set);
        let mut group = criterion.benchmark_group(format!("{set:?}"));
        group.throughput(Throughput::Elements(1));
        let (mut one, mut count) = (arm.clone(), 0);
        group.bench_function("one arm", |bench| {
            bench.iter(|| {
                count += 1;
                one.step(command(count)).unwrap();
            });
        });
        group.throughput(Throughput::Elements(ArmLanes::WIDTH as u64));
        let (mut lanes, mut count) = (ArmLanes::new(&[&arm; ArmLanes::WIDTH]).unwrap(), 0);
        group.bench_function("eight arms", |bench| {
            bench.iter(|| {
                count += 1;
                assert!(lanes.step(&[command(count); ArmLanes::WIDTH], &[true; ArmLanes::WIDTH]));
            });
        });
        group.finish();
    }
}

criterion_group!(benches, step);
criterion_main!(benches);
