//! Faulty scans of one person: what is right stays right, what cannot be is refused, and what is wrong says so.

use experiments::faulty_scans::{FaultRow, Verdict, faulty_scans};
use nonrigid::registration::ModelKind;

#[test]
fn wrong_results_come_with_a_warning() {
    let rows = faulty_scans(1000, 1, &[ModelKind::Hybrid], 7).unwrap();
    assert_eq!(rows.len(), 37);
    let mut faults = Vec::new();
    for row in &rows {
        let FaultRow { fault, landmarks, rmse, doubts, error, .. } = row;
        let verdict = row.verdict();
        let holds = match fault.as_str() {
            "none" => verdict == Verdict::Right,
            // Less than half of the template sees a scan then, and says so.
            "missing 60 %" => matches!(verdict, Verdict::Right | Verdict::RightWithWarning),
            // A face's mirror image is a face: only landmarks tell.
            "mirrored" => *landmarks == 0 || matches!(verdict, Verdict::Refused | Verdict::WrongWithWarning),
            "in metres" | "in centimetres" | "in inches" => {
                error.as_ref().is_some_and(|e| e.contains(&format!("as if it were {fault}")))
            }
            "landmarks misnamed" => matches!(verdict, Verdict::Refused | Verdict::WrongWithWarning),
            "two faces" if *landmarks == 0 => verdict != Verdict::WrongAndSilent,
            _ => matches!(verdict, Verdict::Right | Verdict::RightWithWarning),
        };
        if !holds {
            faults.push(format!("{fault}, {landmarks} landmarks: {verdict:?}, {rmse:?} mm, {doubts:?}, {error:?}"));
        }
    }
    assert!(faults.is_empty(), "{}", faults.join("\n"));
}
