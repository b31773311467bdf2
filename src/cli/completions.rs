//! `nonrigid completions`.

use clap::Args;
use clap_complete::Shell;

use super::{Failure, command, say};

const WHERE: &str = "\
Where the script belongs; it counts from the next shell on:
  bash        ~/.local/share/bash-completion/completions/nonrigid, which the package bash-completion reads
  zsh         ~/.zfunc/_nonrigid, with 'fpath+=(~/.zfunc); autoload -U compinit; compinit' in ~/.zshrc
  fish        ~/.config/fish/completions/nonrigid.fish
  powershell  at the end of the file that $PROFILE names
  elvish      at the end of ~/.config/elvish/rc.elv

Examples, for bash and for zsh:
  mkdir -p ~/.local/share/bash-completion/completions
  nonrigid completions bash > ~/.local/share/bash-completion/completions/nonrigid
  mkdir -p ~/.zfunc
  nonrigid completions zsh > ~/.zfunc/_nonrigid";

/// Arguments of `nonrigid completions`.
#[derive(Debug, Args)]
#[command(after_help = WHERE)]
pub struct Arguments {
    /// Whose completions to print
    shell: Shell,
}

/// Runs the command.
pub fn run(a: &Arguments) -> Result<(), Failure> {
    let mut script = Vec::new();
    clap_complete::generate(a.shell, &mut command(), "nonrigid", &mut script);
    say(String::from_utf8_lossy(&script).trim_end())
}
