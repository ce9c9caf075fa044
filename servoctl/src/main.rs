//! The host tool: see [`servoctl::cli`].

fn main() -> std::process::ExitCode {
    servoctl::cli::main()
}
