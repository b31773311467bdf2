//! A few kinds of what can be wrong: what is right stays right, what cannot be solved is refused or doubted.

use experiments::silence::{Set, SilenceRow, Sources, Verdict, diagram, jobs, run_job, some_jobs};

#[test]
fn wrong_results_are_doubted_refused_or_said_to_be_unknowable() {
    // As many vertices as the calibration was fitted on: a coarser template ends farther off, and is doubted sooner.
    let sources = Sources::new(2000, Vec::new()).unwrap();
    let doubted = [Verdict::Refused, Verdict::BadDoubted];
    let expected: [(&str, &[Verdict]); 7] = [
        ("none", &[Verdict::Good]),
        ("holes", &[Verdict::Good]),
        ("inside out", &[Verdict::Good]),
        ("landmarks misnamed", &doubted),
        ("mirrored", &doubted),
        ("mirrored, no landmarks", &[Verdict::Undetermined, Verdict::BadDoubted, Verdict::Refused]),
        ("ball", &doubted),
    ];
    let mut rows: Vec<SilenceRow> = Vec::new();
    for (kind, allowed) in expected {
        let of_kind: Vec<_> = jobs(Set::Test, 1, 0, 0).into_iter().filter(|job| job.kind.name == kind).collect();
        assert_eq!(of_kind.len(), 1, "{kind}");
        let row = run_job(&sources, &of_kind[0]).unwrap();
        // A mirrored scan whose landmarks are too few to tell is one without.
        let few = row.landmarks < 4 && row.verdict() == Verdict::Undetermined;
        // Without landmarks none has a wrong name.
        let few = few || (row.landmarks == 0 && kind == "landmarks misnamed");
        // A right result without any may be doubted.
        let few = few || (row.landmarks == 0 && kind == "holes" && row.verdict() == Verdict::GoodDoubted);
        assert!(allowed.contains(&row.verdict()) || few, "{kind}: {:?}, {row:?}", row.verdict());
        rows.push(row);
    }
    assert_eq!(
        diagram(&rows).iter().map(|band| band.2).sum::<usize>(),
        rows.iter().filter(|r| r.rmse.is_some()).count()
    );
}

#[test]
fn sets_are_apart_and_some_jobs_are_spread_over_all_kinds() {
    let [design, test] = [Set::Design, Set::Test].map(|set| jobs(set, 3, 8, 2));
    assert!(design.iter().all(|job| job.kind.design) && test.iter().any(|job| !job.kind.design));
    let shown = |jobs: &[experiments::silence::Job]| jobs.iter().map(|job| format!("{job:?}")).collect::<Vec<_>>();
    assert!(shown(&design).iter().all(|job| !shown(&test).contains(job)));
    for count in [14, 60] {
        let jobs = some_jobs(count);
        let mut distinct = shown(&jobs);
        distinct.sort();
        distinct.dedup();
        assert_eq!((jobs.len(), distinct.len()), (count, count));
        assert!(jobs.iter().any(|job| job.kind.design) && jobs.iter().any(|job| !job.kind.design));
    }
}
