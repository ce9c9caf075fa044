//! Keeps a virtual drive running behind a TCP port.

use std::net::{SocketAddr, TcpListener};
use std::path::{Path, PathBuf};
use std::time::Duration;

use anyhow::{Context, Result, ensure};
use clap::Parser;
use servo_host_tests::tuning;
use servo_sim::Stage;
use servo_virtual_board::serve::{Service, serve};
use servo_virtual_board::{Config, Elf, VirtualBoard, flash};
use servoctl::link::virtual_drive::publish;

/// Keeps a virtual drive running behind a TCP port: the bytes of its serial link.
#[derive(Parser)]
#[command(version)]
struct Arguments {
    /// Where to listen: a loopback address; port 0 takes a free one
    #[arg(long, default_value = "127.0.0.1:0")]
    listen: SocketAddr,
    /// Listen on an address that other computers reach: anybody there can move the drive
    #[arg(long)]
    any_address: bool,
    /// The firmware; otherwise the variable SERVO_ELF says where it is
    #[arg(long)]
    elf: Option<PathBuf>,
    /// Stage file; the built-in stage if not given
    #[arg(long)]
    stage: Option<PathBuf>,
    /// Seed of every random number
    #[arg(long, default_value_t = 1)]
    seed: u64,
    /// A new drive, whose parameters nobody has saved; without it they fit the stage, and its motor counts as aligned
    #[arg(long)]
    blank: bool,
    /// Write the firmware's log to this file
    #[arg(long)]
    log: Option<PathBuf>,
    /// Write the address to this file, and end when somebody removes it
    #[arg(long)]
    state: Option<PathBuf>,
    /// End after so many minutes without a client
    #[arg(long, default_value_t = 60)]
    idle_minutes: u64,
    /// Let time pass without a client, too
    #[arg(long)]
    runs_on: bool,
}

/// The start-up takes 76 ms.
const BOOT: Duration = Duration::from_millis(150);

fn main() -> Result<()> {
    let arguments = Arguments::parse();
    ensure!(
        arguments.listen.ip().is_loopback() || arguments.any_address,
        "--listen {}: other computers can reach this address; --any-address says that they may",
        arguments.listen
    );
    let stage = match &arguments.stage {
        None => Stage::default(),
        Some(path) => read_stage(path)?,
    };
    let parameters = match arguments.blank {
        true => Default::default(),
        false => flash::saved(&tuning::settings(&stage, &tuning::STANDARD)?),
    };
    let elf = Elf::find(arguments.elf.as_deref())?;
    let mut board = VirtualBoard::boot(&elf, &Config { stage, seed: arguments.seed, parameters, ..Config::default() })?;
    let listener = TcpListener::bind(arguments.listen).with_context(|| format!("listening on {}", arguments.listen))?;
    board.run_for(BOOT)?;
    let address = listener.local_addr()?;
    let state = arguments.state.as_deref();
    let _alive =
        state.map(|path| publish(path, address).with_context(|| format!("writing {}", path.display()))).transpose()?;
    println!("tcp://{address}");
    let service = Service {
        log: arguments.log,
        while_exists: arguments.state.clone(),
        idle: Duration::from_secs(60 * arguments.idle_minutes),
        runs_on: arguments.runs_on,
    };
    let ended = serve(&mut board, &listener, &service);
    if let Some(path) = &arguments.state {
        // Gone already if that is why it ended.
        let _ = std::fs::remove_file(path);
    }
    ended
}

fn read_stage(path: &Path) -> Result<Stage> {
    let text = std::fs::read_to_string(path).with_context(|| format!("reading stage file {}", path.display()))?;
    Stage::from_toml(&text).with_context(|| format!("stage file {}", path.display()))
}
