//! Zip files, also hostile ones.

use std::io::Write as _;
use std::path::Path;

use studio::archive::{export, import};
use studio::case::{Case, FileRef, Pair, Photo, WrapSummary, Wrapped};
use studio::vault::Vault;
use zip::ZipWriter;
use zip::write::SimpleFileOptions;

fn vault() -> (tempfile::TempDir, Vault) {
    let folder = tempfile::tempdir().unwrap();
    let vault = Vault::open(folder.path()).unwrap();
    (folder, vault)
}

/// Name and bytes.
type Entry<'a> = (&'a str, &'a [u8]);

fn write(path: &Path, entries: &[Entry<'_>]) {
    let mut zip = ZipWriter::new(std::fs::File::create(path).unwrap());
    for (name, bytes) in entries {
        zip.start_file(*name, SimpleFileOptions::default()).unwrap();
        zip.write_all(bytes).unwrap();
    }
    zip.finish().unwrap();
}

fn document(case: &Case) -> Vec<u8> {
    serde_json::to_vec(&serde_json::json!({ "format": 1, "case": case })).unwrap()
}

#[test]
fn a_case_comes_back_the_same_in_another_vault() {
    let [(_one, from), (_two, to)] = [vault(), vault()];
    let at = from.add_bytes("photo.png", b"png").unwrap();
    let case =
        Case { name: "Ä/ö ..".to_owned(), photos: vec![Photo { at, name: "p".to_owned() }], ..Case::default() };
    let id = from.add_case(&case).unwrap();
    let (zip, _) = export(&from, id).unwrap();
    let new = import(&to, &from.path(&zip).unwrap()).unwrap();
    assert_eq!(to.case(new).unwrap().case, case);
    assert_eq!(std::fs::read(to.path(&case.photos[0].at).unwrap()).unwrap(), b"png");
    // twice gives two clients, not a mixture
    assert_ne!(import(&to, &from.path(&zip).unwrap()).unwrap(), new);
}

#[test]
fn a_name_of_many_bytes_can_be_exported() {
    let (_folder, vault) = vault();
    let id = vault.add_case(&Case { name: "\u{20000}".repeat(50), ..Case::default() }).unwrap();
    let (at, _) = export(&vault, id).unwrap();
    assert_eq!(at.file, format!("{}.zip", "\u{20000}".repeat(25)));
}

#[test]
fn what_is_damaged_is_not_exported_as_if_it_were_whole() {
    let [(folder, from), (_other, to)] = [vault(), vault()];
    let [old, new] = ["old.png", "new.png"].map(|name| from.add_bytes(name, name.as_bytes()).unwrap());
    let with = |at: &FileRef| Case { photos: vec![Photo { at: at.clone(), name: "p".to_owned() }], ..Case::default() };
    let id = from.add_case(&with(&old)).unwrap();
    let put = |label: &str, becomes: Case| {
        from.change(id, label, |case| {
            *case = becomes;
            Ok(())
        })
        .unwrap()
    };
    put("photo", with(&new));
    let last = put("name", Case { name: "A".to_owned(), ..with(&new) });
    let file = |at: &FileRef| folder.path().join("assets").join(&at.asset).join(&at.file);
    let removed = |path: &Path| std::fs::remove_file(path).unwrap();
    let changed = |path: &Path| std::fs::write(path, "x").unwrap();
    let unreadable = |path: &Path| {
        removed(path);
        std::fs::create_dir(path).unwrap();
    };
    let folder_gone = |path: &Path| std::fs::remove_dir_all(path.parent().unwrap()).unwrap();
    let damages: [&dyn Fn(&Path); 4] = [&removed, &changed, &unreadable, &folder_gone];
    for damage in damages {
        damage(&file(&new));
        let error = export(&from, id).unwrap_err().0;
        assert!(error.contains("changed there: new.png; add the same ones again"), "{error}");
        assert_eq!(from.add_bytes("new.png", b"new.png").unwrap(), new);
        assert_eq!(export(&from, id).unwrap().1, 0);
    }
    // what only an older revision has holds nothing up
    removed(&file(&old));
    let (zip, left_out) = export(&from, id).unwrap();
    assert_eq!(left_out, 1);
    let there = import(&to, &from.path(&zip).unwrap()).unwrap();
    assert_eq!(to.case(there).unwrap().case, last.case);
    assert_eq!(to.step(there, false).unwrap().case, with(&new));
    assert!(to.step(there, false).is_err());
}

#[test]
fn a_case_that_breaks_the_rules_of_edits_is_refused() {
    let (_folder, vault) = vault();
    let outside = tempfile::tempdir().unwrap();
    let path = outside.path().join("case.zip");
    let at = vault.add_bytes("x.obj", b"x").unwrap();
    let there = format!("assets/{}/x.obj", at.asset);
    let refused = |why: &str, change: &dyn Fn(&mut Case)| {
        let mut case = Case::default();
        change(&mut case);
        write(&path, &[("case.json", &document(&case)), (&there, b"x")]);
        let error = import(&vault, &path).unwrap_err().0;
        assert!(error.contains(why), "{why}: {error}");
    };
    let pair = |name: &str| Pair { name: name.to_owned(), vertex: None, target: None, doubt: None, by_hand: false };
    let file = |name: &str| FileRef { file: name.to_owned(), ..at.clone() };
    refused("give it a name", &|case| case.name = " ".to_owned());
    refused("at most 200 bytes", &|case| case.name = "x".repeat(100_000));
    refused("longer than", &|case| case.notes = "x".repeat(200_000));
    refused("no weight lies between", &|case| case.wrap.identity_bounds = Some([3.0, -3.0]));
    refused("no-such", &|case| case.wrap.model = Some("no-such".to_owned()));
    refused("two plans", &|case| case.plans.push(case.plans[0].clone()));
    refused("no plan 9", &|case| case.plan = 9);
    refused("comes twice", &|case| case.wrap.pairs = vec![pair("a"), pair("a")]);
    refused("the scan in work", &|case| case.scan = Some(3));
    refused("\"gone.obj\" is missing", &|case| case.photos.push(Photo { at: file("gone.obj"), name: String::new() }));
    refused("cannot be the name", &|case| case.photos.push(Photo { at: file("../x.obj"), name: String::new() }));
    assert!(vault.cases("").unwrap().is_empty());
}

#[test]
fn the_history_goes_with_the_case() {
    let [(_one, from), (_two, to)] = [vault(), vault()];
    let first = from.add_bytes("photo.png", b"first").unwrap();
    let case = Case { photos: vec![Photo { at: first.clone(), name: "p".to_owned() }], ..Case::default() };
    let id = from.add_case(&case).unwrap();
    let name = |name: &str| {
        from.change(id, &format!("named {name}"), |case| {
            case.name = name.to_owned();
            case.photos.clear();
            Ok(())
        })
        .unwrap()
    };
    name("A");
    name("B");
    from.step(id, false).unwrap();
    let zip = from.path(&export(&from, id).unwrap().0).unwrap();
    let new = import(&to, &zip).unwrap();
    assert_eq!(to.history(new).unwrap(), from.history(id).unwrap());
    let open = to.case(new).unwrap();
    assert_eq!((&*open.case.name, open.undo.as_deref(), open.redo.as_deref()), ("A", Some("named A"), Some("named B")));
    assert_eq!(to.step(new, true).unwrap().case.name, "B");
    to.step(new, false).unwrap();
    // what only an older revision has is there too
    assert_eq!(to.step(new, false).unwrap().case, case);
    assert_eq!(std::fs::read(to.path(&first).unwrap()).unwrap(), b"first");

    // a history that leads elsewhere, or nowhere, is refused
    let outside = tempfile::tempdir().unwrap();
    let path = outside.path().join("case.zip");
    let other = Case { name: "other".to_owned(), ..Case::default() };
    let good = Case::default();
    for (head, revisions) in [(0, vec![("x", &other)]), (1, vec![("x", &good)]), (0, vec![])] {
        let history = serde_json::json!({ "head": head, "revisions": revisions });
        let text = serde_json::json!({ "format": 2, "case": good, "history": history }).to_string();
        write(&path, &[("case.json", text.as_bytes())]);
        assert!(import(&to, &path).unwrap_err().0.contains("history"), "{text}");
    }
    assert_eq!(to.cases("").unwrap().len(), 1);
}

#[test]
fn hostile_zip_files_are_refused_and_leave_nothing() {
    let (folder, vault) = vault();
    let outside = tempfile::tempdir().unwrap();
    let path = outside.path().join("case.zip");
    let good = document(&Case::default());
    let zeros = "0".repeat(64);
    let inside = format!("assets/{zeros}/a.png");
    let asked = Case { photos: vec![Photo { at: crate::client::no_file(), name: String::new() }], ..Case::default() };
    let mut recipe = Case::default();
    recipe.plans[0].recipe = "[[step]]\n[[step.mask]]\nweights = '/etc/passwd'\ndisplacement = [0, 0, 1]".to_owned();
    let [missing, named] = [&asked, &recipe].map(document);
    // what is copied into a shell writes nowhere but where the user stands
    let at = vault.add_bytes("x.obj", b"x").unwrap();
    let there = format!("assets/{}/x.obj", at.asset);
    let commanded = |words: &[&str]| {
        let wrapped = Wrapped {
            mesh: at.clone(),
            state: at.clone(),
            report: at.clone(),
            command: words.iter().map(|w| (*w).to_owned()).collect(),
            model: "rigid".to_owned(),
            scan: String::new(),
            summary: WrapSummary {
                within: 1.0,
                median: 0.0,
                p95: 0.0,
                flipped: 0,
                probability: 0.0,
                steps: 1,
                doubts: Vec::new(),
            },
        };
        document(&Case { wrapped: Some(wrapped), ..Case::default() })
    };
    let writes = commanded(&["register", "--out", "/home/user/.profile"]);
    let reads = commanded(&["register", "--template", "/etc/passwd", "--out", "wrapped.obj"]);
    let bomb = vec![0u8; 400 << 20];
    let cases: [(&str, &[Entry<'_>]); 14] = [
        ("no case.json", &[]),
        ("../evil", &[("case.json", &good), ("../../evil.png", b"x")]),
        ("/tmp/evil", &[("case.json", &good), ("/tmp/evil.png", b"x")]),
        ("..", &[("case.json", &good), ("assets/../a.png", b"x")]),
        ("name", &[("case.json", &good), ("assets/0/..\\evil.png", b"x")]),
        ("was changed", &[("case.json", &good), (&inside, b"x")]),
        ("missing", &[("case.json", &missing)]),
        ("case", &[("case.json", b"{")]),
        ("format is 9", &[("case.json", b"{\"format\":9,\"case\":{}}")]),
        ("not in the vault", &[("case.json", &named)]),
        ("command line", &[("case.json", &writes), (&there, b"x")]),
        ("command line", &[("case.json", &reads), (&there, b"x")]),
        ("unpacks to more", &[("case.json", &good), (&inside, &bomb)]),
        ("unpacks to more", &[("case.json", &bomb)]),
    ];
    for (why, entries) in cases {
        write(&path, entries);
        let error = import(&vault, &path).unwrap_err().0;
        assert!(error.contains(why) && !error.contains(" at line "), "{why}: {error}");
    }
    std::fs::write(&path, b"PK\x03\x04 nothing").unwrap();
    assert!(import(&vault, &path).unwrap_err().0.contains("no zip file, or not a whole one"));
    assert!(vault.cases("").unwrap().is_empty());
    let left: Vec<_> = std::fs::read_dir(folder.path().join("incoming")).unwrap().collect();
    assert!(left.is_empty(), "{left:?}");
    assert!(!Path::new("/tmp/evil.png").exists() && !folder.path().join("evil.png").exists());
}
