//! A page of the book from a command line: every command, every option, examples.

use clap::Command;

/// A page of Markdown with every command of the tree: what it does, every option, examples.
pub fn page(root: &Command) -> String {
    let mut built = root.clone();
    built.build();
    let name = built.get_name().to_owned();
    let of = if built.has_subcommands() { " COMMAND" } else { "" };
    let mut page = format!(
        "<!-- Generated from the code by a test; see tests/support/generated_page.rs. -->\n# Options of `{name}`\n\n\
         As `{name}{of} --help` prints them. An option in angle brackets takes a value.\n"
    );
    section(&built, &mut page);
    page
}

fn section(command: &Command, page: &mut String) {
    let name = command.get_bin_name().unwrap_or(command.get_name());
    let about = command.get_long_about().or(command.get_about()).map(ToString::to_string).unwrap_or_default();
    *page += &format!("\n## {name}\n\n{}\n\n", prose(&about, ""));
    let usage = command.clone().render_usage().to_string();
    *page += &format!("```text\n{}\n```\n", usage.trim_start_matches("Usage:").trim());
    let mut heading = None;
    let shown = |a: &&clap::Arg| !a.is_hide_set() && !matches!(a.get_id().as_str(), "help" | "version");
    for argument in command.get_arguments().filter(shown) {
        if argument.get_help_heading() != heading || !page.ends_with('\n') {
            heading = argument.get_help_heading();
            if let Some(heading) = heading {
                *page += &format!("\n**{heading}**\n");
            }
        }
        *page += &option(argument);
    }
    let after = command.get_after_long_help().or(command.get_after_help()).map(ToString::to_string).unwrap_or_default();
    for paragraph in after.trim().split("\n\n").filter(|p| !p.is_empty()) {
        match paragraph.split_once('\n').filter(|(first, _)| first.starts_with("Example")) {
            Some((first, lines)) => {
                let lines: Vec<&str> = lines.lines().map(|l| l.strip_prefix("  ").unwrap_or(l)).collect();
                *page += &format!("\n{}\n\n```sh\n{}\n```\n", prose(first, ""), lines.join("\n"));
            }
            None => *page += &format!("\n{}\n", prose(paragraph, "")),
        }
    }
    command.get_subcommands().filter(|c| c.get_name() != "help").for_each(|c| section(c, page));
}

/// An option as an item of a list: how it is written, what it does, default and values.
fn option(argument: &clap::Arg) -> String {
    let short = argument.get_short().filter(|_| argument.get_long().is_some());
    let short = short.map(|c| format!("-{c}, ")).unwrap_or_default();
    let help = argument.get_long_help().or(argument.get_help()).map(ToString::to_string).unwrap_or_default();
    let mut text = format!("\n- **`{short}{argument}`**");
    if argument.is_required_set() {
        text += " (required)";
    }
    if argument.is_global_set() {
        text += " (of every command)";
    }
    text += &format!(": {}", prose(&help, "  "));
    let takes_value = argument.get_action().takes_values();
    let defaults: Vec<_> = argument.get_default_values().iter().map(|v| format!("`{}`", v.to_string_lossy())).collect();
    if takes_value && !defaults.is_empty() {
        text += &format!(" Default: {}.", defaults.join(", "));
    }
    let values: Vec<_> = argument.get_possible_values().into_iter().filter(|v| !v.is_hide_set()).collect();
    if takes_value && values.iter().any(|v| v.get_help().is_some()) {
        for value in values {
            let help = value.get_help().map(|h| format!(": {}", prose(&h.to_string(), "    "))).unwrap_or_default();
            text += &format!("\n  - `{}`{help}", value.get_name());
        }
    } else if takes_value && !values.is_empty() {
        let names: Vec<_> = values.iter().map(|v| format!("`{}`", v.get_name())).collect();
        text += &format!(" One of {}.", names.join(", "));
    }
    text + "\n"
}

/// Plain text as Markdown, further lines indented, a sentence with its full stop.
fn prose(text: &str, indent: &str) -> String {
    let mut escaped = String::new();
    let mut code = false;
    for c in text.trim().chars() {
        code ^= c == '`';
        match c {
            '<' if !code => escaped += "&lt;",
            '*' | '[' | ']' | '|' if !code => escaped.extend(['\\', c]),
            '\n' => escaped.extend(['\n'].into_iter().chain(indent.chars())),
            _ => escaped.push(c),
        }
    }
    if escaped.ends_with(|c: char| c.is_alphanumeric() || matches!(c, ')' | ']' | '`' | '"' | '\'')) {
        escaped.push('.');
    }
    escaped
}
