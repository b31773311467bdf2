//! What the vault keeps, and what it lets go.

use std::process::Command;

use studio::case::{Case, Edit, Pair, Photo};
use studio::error::problem;
use studio::vault::{Article, Vault};

fn pair(name: String) -> Edit {
    let target = Some([1.0, 2.0, 0.1 + 0.2]);
    Edit::SetPair { pair: Pair { name, vertex: Some(1), target, doubt: None, by_hand: true } }
}

#[test]
fn several_programs_on_one_vault_lose_nothing() {
    let folder = tempfile::tempdir().unwrap();
    let vault = Vault::open(folder.path()).unwrap();
    let id = vault.add_case(&Case::default()).unwrap();
    std::thread::scope(|scope| {
        for program in 0..4 {
            let path = folder.path();
            scope.spawn(move || {
                let vault = Vault::open(path).unwrap();
                for k in 0..15 {
                    vault.edit(id, &pair(format!("{program}-{k}"))).unwrap();
                }
            });
        }
    });
    let open = vault.case(id).unwrap();
    assert_eq!((open.case.wrap.pairs.len(), open.revision), (60, 61));
    assert_eq!(open.case.wrap.pairs[0].target, Some([1.0, 2.0, 0.1 + 0.2]));
}

#[test]
fn undo_and_redo_go_through_everything_and_survive_a_restart() {
    let folder = tempfile::tempdir().unwrap();
    let id = {
        let vault = Vault::open(folder.path()).unwrap();
        let id = vault.add_case(&Case::default()).unwrap();
        for k in 0..50 {
            vault.edit(id, &pair(k.to_string())).unwrap();
        }
        id
    };
    let vault = Vault::open(folder.path()).unwrap();
    for left in (0..50).rev() {
        assert_eq!(vault.step(id, false).unwrap().case.wrap.pairs.len(), left);
    }
    assert!(vault.step(id, false).is_err());
    for there in 1..=30 {
        assert_eq!(vault.step(id, true).unwrap().case.wrap.pairs.len(), there);
    }
    let open = vault.case(id).unwrap();
    assert_eq!((open.undo.as_deref(), open.redo.as_deref()), (Some("landmark 29"), Some("landmark 30")));
    // a new change ends what could be done again, and its number was that of no other
    let new = vault.edit(id, &pair("new".to_owned())).unwrap();
    assert_eq!((new.undo.as_deref(), new.redo, new.revision), (Some("landmark new"), None, 52));
    assert_eq!(vault.step(id, false).unwrap(), vault.case(id).unwrap());
    assert_eq!(vault.step(id, true).unwrap().case, new.case);
    assert!(vault.edit_on(id, 51, &pair("late".to_owned())).unwrap_err().0.contains("meanwhile"));
    assert!(vault.step(id, true).is_err());
    // a change that fails leaves no trace
    let before = vault.case(id).unwrap();
    let failed = vault.change(id, "nothing", |case| {
        case.name = "changed".to_owned();
        Err(problem("no"))
    });
    assert!(failed.is_err() && vault.case(id).unwrap() == before);
}

/// A child that changes a case until it is killed.
#[test]
fn killed_at_any_moment_a_case_stays_whole() {
    if let Some(folder) = std::env::var_os("STUDIO_TEST_WRITER") {
        let vault = Vault::open(folder.as_ref()).unwrap();
        for k in 0.. {
            vault.edit(1, &pair((k % 1000).to_string())).unwrap();
            let at = vault.add_bytes("a.png", format!("{k}").as_bytes()).unwrap();
            vault
                .change(1, "photo", |case| {
                    case.photos = vec![Photo { at, name: k.to_string() }];
                    Ok(())
                })
                .unwrap();
        }
    }
    let folder = tempfile::tempdir().unwrap();
    let id = Vault::open(folder.path()).unwrap().add_case(&Case::default()).unwrap();
    let mut last = 0;
    for round in 0..6u64 {
        let mut child = Command::new(std::env::current_exe().unwrap())
            .args(["vault::killed_at_any_moment_a_case_stays_whole", "--exact", "--nocapture"])
            .env("STUDIO_TEST_WRITER", folder.path())
            .stdout(std::process::Stdio::null())
            .spawn()
            .unwrap();
        std::thread::sleep(std::time::Duration::from_millis(150 + 37 * round));
        child.kill().unwrap();
        child.wait().unwrap();
        let vault = Vault::open(folder.path()).unwrap();
        let open = vault.case(id).unwrap();
        assert!(open.revision >= last);
        last = open.revision;
        for photo in &open.case.photos {
            let text = std::fs::read_to_string(vault.path(&photo.at).unwrap()).unwrap();
            assert_eq!(text, photo.name);
        }
        assert!(vault.step(id, false).is_ok() || open.revision == 1);
        if open.revision > 1 {
            vault.step(id, true).unwrap();
        }
    }
    assert!(last > 1, "the child has written nothing");
}

#[test]
#[cfg(unix)]
fn a_vault_that_is_not_in_its_place_takes_nothing() {
    let outer = tempfile::tempdir().unwrap();
    let [folder, elsewhere] = ["vault", "moved"].map(|name| outer.path().join(name));
    let vault = Vault::open(&folder).unwrap();
    let id = vault.add_case(&Case::default()).unwrap();
    let refused = || vault.edit(id, &pair("lost".to_owned())).unwrap_err().0.contains("moved, removed or replaced");
    std::fs::rename(&folder, &elsewhere).unwrap();
    assert!(refused());
    drop(Vault::open(&folder).unwrap());
    assert!(refused());
    std::fs::remove_dir_all(&folder).unwrap();
    std::fs::rename(&elsewhere, &folder).unwrap();
    assert_eq!(vault.edit(id, &pair("kept".to_owned())).unwrap().case.wrap.pairs.len(), 1);
}

#[test]
fn deleted_is_deleted_and_shared_files_stay() {
    let folder = tempfile::tempdir().unwrap();
    let vault = Vault::open(folder.path()).unwrap();
    let secret = b"a patient's face, nobody else's";
    let [own, shared] =
        [vault.add_bytes("own.png", secret).unwrap(), vault.add_bytes("shared.png", b"shared").unwrap()];
    let photo = |at: &studio::case::FileRef| Photo { at: at.clone(), name: "p".to_owned() };
    let name = "Erika Mustermann-Unverwechselbar";
    let one = Case { name: name.to_owned(), photos: vec![photo(&own), photo(&shared)], ..Case::default() };
    let two = Case { photos: vec![photo(&shared)], ..Case::default() };
    let [one, two] = [&one, &two].map(|case| vault.add_case(case).unwrap());
    // also what only an older revision has, what was undone, and what was made of it
    vault.edit(one, &Edit::RemovePhoto { index: 0 }).unwrap();
    let [undone, export, late] =
        ["undone.png", "morphed.obj", "late.obj"].map(|name| vault.add_bytes(name, name.as_bytes()).unwrap());
    let add = |at| {
        move |case: &mut Case| {
            case.photos.push(photo(at));
            Ok(())
        }
    };
    vault.change(one, "photo", add(&undone)).unwrap();
    vault.step(one, false).unwrap();
    vault.change(one, "photo", add(&shared)).unwrap();
    vault.leave(one, &export).unwrap();
    assert!([&own, &undone, &export].iter().all(|at| vault.path(at).is_ok()));
    vault.delete_case(one).unwrap();
    assert!([&own, &undone, &export].iter().all(|at| vault.path(at).is_err()) && vault.path(&shared).is_ok());
    // What comes after it does not stay, but for what another case has.
    assert!(vault.leave(one, &late).is_err() && vault.path(&late).is_err());
    assert!(vault.leave(one, &shared).is_err() && vault.path(&shared).is_ok());
    assert!(vault.case(one).is_err() && vault.case(two).is_ok() && vault.delete_case(one).is_err());
    for file in ["vault.sqlite", "vault.sqlite-wal"] {
        let bytes = std::fs::read(folder.path().join(file)).unwrap_or_default();
        assert!(!bytes.windows(name.len()).any(|w| w == name.as_bytes()), "{file} still has the name");
    }
}

#[test]
fn a_case_that_cannot_be_read_locks_no_other_out() {
    for document in ["{", "{}"] {
        let folder = tempfile::tempdir().unwrap();
        let vault = Vault::open(folder.path()).unwrap();
        let [bad, good] =
            ["bad", "good"].map(|name| vault.add_case(&Case { name: name.to_owned(), ..Case::default() }));
        let [bad, good] = [bad.unwrap(), good.unwrap()];
        let database = rusqlite::Connection::open(folder.path().join("vault.sqlite")).unwrap();
        database.execute("UPDATE revisions SET document = ?1 WHERE case_id = ?2", (document, bad)).unwrap();
        drop(vault);
        let vault = Vault::open(folder.path()).unwrap();
        let error = vault.case(bad).unwrap_err().0;
        assert!(error.contains("from a backup") && !error.contains("line"), "{error}");
        let cases = vault.cases("not in any").unwrap();
        assert!(cases.len() == 1 && cases[0].id == bad && cases[0].trouble.is_some(), "{cases:?}");
        assert_eq!(vault.edit(good, &pair("nose".to_owned())).unwrap().case.name, "good");
        // nobody knows which files are the bad one's: none goes, until it is deleted itself
        assert!(vault.delete_case(good).unwrap_err().0.contains("cannot be read"));
        vault.delete_case(bad).unwrap();
        vault.delete_case(good).unwrap();
    }
}

#[test]
fn an_older_vault_is_brought_up_and_a_newer_one_refused() {
    let folder = tempfile::tempdir().unwrap();
    let (id, case) = {
        let vault = Vault::open(folder.path()).unwrap();
        let id = vault.add_case(&Case { name: "kept".to_owned(), ..Case::default() }).unwrap();
        (id, vault.case(id).unwrap())
    };
    let change =
        |sql: &str| rusqlite::Connection::open(folder.path().join("vault.sqlite")).unwrap().execute_batch(sql).unwrap();
    for older in [
        "DROP TABLE leftovers; PRAGMA user_version = 2",
        "DROP TABLE leftovers; DROP TABLE articles; PRAGMA user_version = 1",
    ] {
        change(older);
        let vault = Vault::open(folder.path()).unwrap();
        assert_eq!(vault.case(id).unwrap(), case);
        assert_eq!(vault.articles("").unwrap().len(), 20);
        let export = vault.add_bytes("morphed.obj", b"v 0 0 0").unwrap();
        vault.leave(id, &export).unwrap();
    }
    change("PRAGMA user_version = 99");
    let error = Vault::open(folder.path()).err().unwrap().0;
    assert!(error.contains("99"), "{error}");
}

#[test]
fn articles_are_found_changed_and_deleted() {
    let folder = tempfile::tempdir().unwrap();
    let vault = Vault::open(folder.path()).unwrap();
    assert!(vault.articles("nose").unwrap().len() >= 2);
    assert!(vault.articles("").unwrap().iter().all(|a| studio::plan::read(&a.recipe).is_ok()));
    let article = Article {
        id: 0,
        title: "Mine".to_owned(),
        tags: String::new(),
        body: "# Über Nähte".to_owned(),
        recipe: String::new(),
    };
    let id = vault.save_article(&article).unwrap();
    assert_eq!(vault.articles("nähte").unwrap()[0].id, id);
    assert!(vault.save_article(&Article { recipe: "step = 1".to_owned(), ..article.clone() }).is_err());
    assert!(vault.save_article(&Article { title: " ".to_owned(), ..article.clone() }).is_err());
    assert!(vault.save_article(&Article { id: 999, ..article }).is_err());
    vault.delete_article(id).unwrap();
    assert_eq!(vault.articles("").unwrap().len(), 20);
}
