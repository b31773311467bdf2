//! The same files at 1, 2 and 4 threads and from run to run. The report, `scan-bench --terms` and `real-scans` have this beside their own
//! tests; `scaling`, `solver-case` and `start-bench` print times.

use crate::repeats::leaves_equal_files;
use experiments::generated::write_standard_cases;

const PROGRAM: &str = env!("CARGO_BIN_EXE_experiments");

#[test]
fn commands_leave_the_same_files() {
    let folder = tempfile::tempdir().unwrap();
    write_standard_cases(folder.path(), 1000, 5000, &["same_smile", "new_open"], 7).unwrap();
    for (line, files, stdout) in [
        ("scan-bench cases --rig rig --models hybrid,rigid --turn 20 --threads THREADS --out OUT", 7, false),
        ("scan-bench cases --rig rig --models rigid --landmarks none --threads THREADS --out OUT", 5, false),
        ("dev search-schedules --models rigid --vertices 1000 --budget 2 --threads THREADS --out OUT", 3, true),
        ("compare-rigs rig rig --json", 0, true),
        ("dev more-garbow-hillstrom --json", 0, true),
    ] {
        assert_eq!(leaves_equal_files(PROGRAM, folder.path(), line, stdout), files, "{line}");
    }
}
