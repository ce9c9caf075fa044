//! The recorded run through [`Axis`], called as the firmware calls it.
#![no_std]
#![no_main]

use servo_core::axis::Axis;
use servo_core::config::Config;
use servo_qemu::digest::Digest;
use servo_qemu::image::{self, Failure};
use servo_qemu::regions::{self, Class};
use servo_qemu::script;

#[cortex_m_rt::entry]
fn main() -> ! {
    image::end(run())
}

fn run() -> Result<Digest, Failure> {
    let mut axis = Axis::new(Config::new(&script::settings())?);
    image::replay(|digest, number, tick| {
        if number == script::CAPTURE_TICK {
            axis.arm_capture(script::CAPTURE);
        }
        let command = script::command(number)?;
        regions::enter(Class::of(axis.drive(), &command));
        let output = regions::on_servo(&mut axis, &tick.sample, command);
        digest.servo(&output);
        regions::enter(if output.bridge.enabled { Class::On } else { Class::Off });
        for phases in tick.phases {
            digest.period(regions::on_period(&mut axis, phases));
        }
        Ok(())
    })
}
