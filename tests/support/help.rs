//! Help that ends with examples, and examples that the command's own parser accepts.

use clap::{Command, error::ErrorKind};

/// The examples at the end of a help text: its last paragraph, if that is headed so, command by command. What a shell joins is
/// joined.
pub fn examples(help: &str) -> Vec<String> {
    let Some((heading, lines)) = help.trim_end().rsplit("\n\n").next().and_then(|last| last.split_once('\n')) else {
        return Vec::new();
    };
    if !heading.starts_with("Example") {
        return Vec::new();
    }
    lines.replace("\\\n", " ").lines().map(|line| line.trim().to_owned()).collect()
}

/// The words of a command line, without redirections and comments.
pub fn words(line: &str) -> Vec<&str> {
    line.split_whitespace().take_while(|word| !matches!(*word, ">" | ">>" | "|" | "#")).collect()
}

/// Every command of the tree with its help, the tree's root first.
pub fn helps(root: &Command) -> Vec<(String, String)> {
    let mut built = root.clone();
    built.build();
    let mut found = Vec::new();
    collect(&built, &mut found);
    found
}

fn collect(command: &Command, found: &mut Vec<(String, String)>) {
    let name = command.get_bin_name().unwrap_or(command.get_name()).to_owned();
    found.push((name, command.clone().render_long_help().to_string()));
    command.get_subcommands().filter(|c| c.get_name() != "help").for_each(|c| collect(c, found));
}

/// What is wrong with the examples of a command and of all below it: none, of other commands only, or refused by the parser.
pub fn faults(root: &Command) -> Vec<String> {
    let mut faults = Vec::new();
    for (name, help) in helps(root) {
        let examples = examples(&help);
        let own = |line: &&String| words(line).join(" ").starts_with(&name);
        if examples.iter().filter(own).count() == 0 {
            faults.push(format!("{name}: its help does not end with an example"));
        }
        for line in examples.iter().filter(|line| words(line).first() == Some(&root.get_name())) {
            if let Err(e) = root.clone().try_get_matches_from(words(line))
                && !matches!(e.kind(), ErrorKind::DisplayHelp | ErrorKind::DisplayVersion)
            {
                faults.push(format!("{name}: {line}\n{e}"));
            }
        }
    }
    faults
}
