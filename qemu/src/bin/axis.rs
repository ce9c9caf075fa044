//! The recorded run through [`Axis`], called as the firmware calls it.
#![no_std]
#![no_main]

use servo_core::axis::Axis;
use servo_core::config::Config;
use servo_qemu::digest::Digest;
use servo_qemu::image::{self, Failure};
use servo_qemu::regions::{self, Before, Class};
use servo_qemu::script;

#[cortex_m_rt::entry]
fn main() -> ! {
    image::end(run())
}

fn run() -> Result<Digest, Failure> {
    let mut axis = Axis::new(Config::new(&script::settings())?);
    image::replay(|digest, number, tick| {
        if number == script::SIN_COS_TICK {
            axis = Axis::new(script::sin_cos_config()?);
        }
        if number == script::CAPTURE_TICK {
            axis.arm_capture(script::CAPTURE);
        }
        let before = Before::of(axis.drive());
        let output = regions::on_servo(&mut axis, &tick.sample, script::command(number)?.as_ref());
        digest.servo(&output);
        let mut is_on = output.bridge.enabled;
        for phases in tick.phases {
            let bridge = regions::on_period(&mut axis, phases);
            digest.period(bridge);
            is_on = bridge.enabled;
        }
        Class::of(before, axis.drive().config(), &output.record, output.outcome, is_on).tell();
        Ok(())
    })
}
