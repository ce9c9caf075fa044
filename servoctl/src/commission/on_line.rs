//! A drive on the line, real or virtual, as a link.

use std::sync::atomic::{AtomicBool, Ordering};

use servo_core::SERVO_HZ;
use servo_core::capture;
use servo_core::measure::Reading;
use servo_core::parameters::Settings;
use servo_core::refusal::Refusal;
use servo_protocol::message::Request;

use super::Failure;
use super::link::{Link, Order, Status};
use crate::link::{Capture, Drive, Error};

/// A drive that speaks our protocol.
pub struct OnLine {
    drive: Drive,
    count_m: f64,
}

impl From<Error> for Failure {
    fn from(error: Error) -> Failure {
        match error {
            Error::Refused { refusal, .. } => Failure::Refused(refusal),
            other => Failure::Line(other.to_string()),
        }
    }
}

impl OnLine {
    /// The drive, and the parameters that it uses.
    ///
    /// # Errors
    /// That of the line.
    pub fn new(mut drive: Drive) -> Result<(OnLine, Settings), Failure> {
        let settings = drive.parameters()?;
        Ok((OnLine { drive, count_m: settings.encoder_count_m }, settings))
    }

    /// The drive.
    pub fn drive(&self) -> &Drive {
        &self.drive
    }

    /// Makes a drive whose parameters nobody has saved ready to be commissioned: these are in use and stored, and its fault is
    /// acknowledged.
    ///
    /// # Errors
    /// The drive's refusal, that of the line.
    pub fn prepare(&mut self, settings: &Settings) -> Result<(), Failure> {
        self.configure(settings)?;
        self.save()?;
        match self.drive.order(&Request::ResetFault) {
            // There was none.
            Ok(_) | Err(Error::Refused { refusal: Refusal::WrongState(_), .. }) => Ok(()),
            Err(error) => Err(error.into()),
        }
    }
}

impl Link for OnLine {
    fn serial(&self) -> String {
        self.drive.identity().serial.map(|word| format!("{word:08x}")).concat()
    }

    fn configure(&mut self, settings: &Settings) -> Result<(), Failure> {
        self.drive.make_parameters(settings)?;
        self.count_m = settings.encoder_count_m;
        Ok(())
    }

    fn order(&mut self, order: &Order) -> Result<(), Failure> {
        let request = match *order {
            Order::Enable => Request::Enable,
            Order::Disable => Request::Disable,
            Order::Stop => Request::Stop,
            Order::Move { target_m, limits } => {
                Request::Move { target_ct: (target_m / self.count_m).round() as i64, limits }
            }
            Order::Excite(request) => Request::Excite(request),
            Order::Compensator(compensator) => Request::Compensator(compensator),
        };
        self.drive.order(&request)?;
        Ok(())
    }

    fn status(&mut self) -> Result<Status, Failure> {
        let status = self.drive.status()?;
        Ok(Status {
            state: status.state,
            fault: status.fault,
            position_m: status.position_ct as f64 * self.count_m,
            moving: status.moving,
        })
    }

    fn reading(&mut self) -> Result<Reading, Failure> {
        Ok(self.drive.excitation()?)
    }

    fn arm(&mut self, order: capture::Order) -> Result<(), Failure> {
        Ok(self.drive.arm_capture(order)?)
    }

    fn captured(&mut self) -> Result<Option<Capture>, Failure> {
        match self.drive.status()?.capture {
            capture::Progress::Complete(_) => Ok(Some(self.drive.read_capture(|_, _| ())?)),
            _ => Ok(None),
        }
    }

    fn wait(&mut self, seconds: f64) -> Result<(), Failure> {
        Ok(self.drive.wait((seconds * f64::from(SERVO_HZ)).ceil() as u32)?)
    }

    fn align(&mut self, stop: &AtomicBool) -> Result<Settings, Failure> {
        self.drive.align(|| !stop.load(Ordering::Relaxed))?;
        Ok(self.drive.parameters()?)
    }

    fn save(&mut self) -> Result<(), Failure> {
        self.drive.save_parameters()?;
        Ok(())
    }
}
