//! The programs say what they are. Cargo builds them for this test: the tests in Python run them too.

use std::process::Command;

#[test]
fn the_programs_tell_their_version() {
    for program in [env!("CARGO_BIN_EXE_octoarm-server"), env!("CARGO_BIN_EXE_octoarm-load")] {
        let told = Command::new(program).arg("--version").output().expect("it runs");
        assert!(told.status.success(), "{program}: {told:?}");
        let version = String::from_utf8(told.stdout).expect("a text");
        assert!(version.trim_end().ends_with(env!("CARGO_PKG_VERSION")), "{program}: {version}");
    }
}
