//! Arguments of the program and of its commands.

use super::AppError;
use clap::{Parser, Subcommand};

/// Live multicolor super-resolution imaging (SOFI) with two cameras.
#[derive(Debug, Parser)]
#[command(version, after_help = "Without a command the window opens.")]
pub struct Arguments {
    #[command(subcommand)]
    command: Option<Command>,
}

#[derive(Debug, Subcommand)]
enum Command {
    /// Open the window: cameras, running image, instrument, plans, replay
    Live(super::window::LiveArguments),
    /// Turn two stacks of frames, or one, into the unmixed super-resolved image
    Analyze(Box<super::analyze::AnalyzeArguments>),
    /// Play the simulated microscope through the whole analysis and score it against the truth
    Demo(super::demo::DemoArguments),
    /// Carry out a plan: acquire, record and analyze live
    Run(super::run::RunArguments),
    /// Play a recording or foreign files through mock cameras into the same pipeline
    Replay(super::replay::ReplayArguments),
    /// Write a recording in the other format
    Export(super::keeping::ExportArguments),
    /// Make a recording whole after a crash
    Recover(super::keeping::RecoverArguments),
    /// Measure pairs per second beside this machine's memory bandwidth
    Bench(super::bench::BenchArguments),
    /// Write the frames of both cameras looking at a simulated scene, and the ground truth
    Simulate(super::simulate::SimulateArguments),
    /// Compare the images of an analysis with the ground truth of their simulation
    Score(super::score::ScoreArguments),
    /// Find how the cameras see each other
    Calibrate(super::calibrate::CalibrateArguments),
    /// Choose dyes and dichroic: eigenvalues, noise and crosstalk of a mixture before it is stained
    Dyes(Box<super::dyes::DyesArguments>),
    /// List all faults of a scene, fluorophores or dichroics file
    Check(super::check::CheckArguments),
    /// Show which devices answer, ask them who they are, and start virtual ones
    Devices(super::devices::DevicesArguments),
    /// Be the window of an instrument process; started by it, never by hand
    #[command(hide = true)]
    Window,
    /// Hold lasers and gates for an instrument process; started by it, never by hand
    #[command(hide = true)]
    LaserGuard(super::hardware::GuardArguments),
    /// Be one virtual device; started by `devices virtual up`, never by hand
    #[command(hide = true)]
    VirtualDevice(super::virtual_devices::DeviceArguments),
}

/// Runs the command that the arguments name; returns the exit code.
///
/// # Errors
/// [`AppError`] with the message and exit code of whatever ended the command early.
pub fn run(arguments: Arguments) -> Result<u8, AppError> {
    let command = arguments.command.unwrap_or_else(|| Command::Live(super::window::LiveArguments::default()));
    let done = match command {
        Command::Live(arguments) => super::window::run(&arguments),
        Command::Window => super::window::run_window(),
        Command::Analyze(arguments) => super::analyze::run(&arguments),
        Command::Demo(arguments) => super::demo::run(&arguments),
        Command::Run(arguments) => super::run::run(&arguments),
        Command::Replay(arguments) => super::replay::run(&arguments),
        Command::Export(arguments) => super::keeping::run_export(&arguments),
        Command::Recover(arguments) => return super::keeping::run_recover(&arguments),
        Command::Bench(arguments) => super::bench::run(&arguments),
        Command::Simulate(arguments) => super::simulate::run(&arguments),
        Command::Score(arguments) => super::score::run(&arguments),
        Command::Calibrate(arguments) => super::calibrate::run(&arguments),
        Command::Dyes(arguments) => super::dyes::run(&arguments),
        Command::Check(arguments) => super::check::run(&arguments),
        Command::Devices(arguments) => super::devices::run(&arguments),
        Command::LaserGuard(arguments) => super::hardware::run_guard(&arguments),
        Command::VirtualDevice(arguments) => super::virtual_devices::run(&arguments),
    };
    done.map(|()| 0)
}
