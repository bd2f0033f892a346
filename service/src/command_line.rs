//! Command lines of this project's binaries.

use clap::{Arg, Command, Parser};

/// Reads the command line of this process. On an error, or for help, it ends the process as Clap does.
///
/// A value may begin with a minus sign and a digit: a number that is too small is refused with its limits, not as a flag that
/// does not exist.
#[must_use]
pub fn parse<P: Parser>() -> P {
    let mut matches = with_negative_numbers(P::command()).get_matches();
    P::from_arg_matches_mut(&mut matches).unwrap_or_else(|error| {
        let mut command = P::command();
        error.format(&mut command).exit()
    })
}

fn with_negative_numbers(command: Command) -> Command {
    let allow = |argument: Arg| match argument.get_action().takes_values() {
        true => argument.allow_negative_numbers(true),
        false => argument,
    };
    command
        .mut_args(allow)
        .mut_subcommands(with_negative_numbers)
}

#[cfg(test)]
mod tests {
    use clap::CommandFactory as _;

    use super::*;

    #[derive(Debug, Parser)]
    struct TriedLine {
        #[command(subcommand)]
        task: TriedTask,
    }

    #[derive(Debug, clap::Subcommand)]
    enum TriedTask {
        Make {
            #[arg(long, value_parser = clap::value_parser!(u32).range(1..=24))]
            hours: u32,
            #[arg(long)]
            bodies: Option<u32>,
            #[arg(long)]
            open: bool,
        },
    }

    #[test]
    fn a_negative_number_is_refused_with_its_value_and_its_limits() {
        let command = || with_negative_numbers(TriedLine::command());
        let refused = |words: &[&str]| {
            let refused = command().try_get_matches_from([&["x", "make"], words].concat());
            refused.expect_err("it is out of range").to_string()
        };
        let hours = refused(&["--hours", "-1"]);
        assert!(
            hours.contains("'-1' for '--hours <HOURS>': -1 is not in 1..=24"),
            "{hours}"
        );
        let bodies = refused(&["--hours", "2", "--bodies", "-1"]);
        assert!(bodies.contains("-1 is not in 0..=4294967295"), "{bodies}");
        let matches = command().try_get_matches_from(["x", "make", "--hours", "2", "--open"]);
        let matches = matches.expect("they are in range");
        let TriedLine {
            task:
                TriedTask::Make {
                    hours,
                    bodies,
                    open,
                },
        } = <TriedLine as clap::FromArgMatches>::from_arg_matches(&matches).expect("all of them");
        assert_eq!((hours, bodies, open), (2, None, true));
    }
}
