//! Commands that talk to a drive: which drive, and what they share.

pub mod align;
pub mod black_box;
pub mod calibrate_encoder;
pub mod capture;
pub mod control;
pub mod faults;
pub mod identity;
pub mod log;
pub mod measure;
pub mod motion;
pub mod params;
pub mod record_file;
pub mod scope;
pub mod sequence;
pub mod settled;
pub mod stream;
pub mod virtual_drive;
pub mod watch;

use anyhow::{Context, Result, bail};
use serialport::SerialPortType;

use crate::link::{Client, Drive, Error, Patience, open, random_id, virtual_drive as background};

/// Which drive.
#[derive(Debug, Clone, Default, clap::Args)]
pub struct Link {
    /// Serial device of the drive, or tcp://HOST:PORT [default: the only one there is]
    #[arg(long, global = true, value_name = "DEVICE", conflicts_with = "virtual_drive", help_heading = "Drive")]
    pub port: Option<String>,
    /// The virtual drive of this computer, started in the background if it does not run
    #[arg(long = "virtual", global = true, help_heading = "Drive")]
    pub virtual_drive: bool,
}

/// A connected drive, and what kind of one.
pub struct Connected {
    /// The drive.
    pub drive: Drive,
    /// It says so itself: nobody can be hurt, and what it measures is simulated.
    pub is_virtual: bool,
}

impl From<Drive> for Connected {
    fn from(drive: Drive) -> Self {
        Connected { is_virtual: drive.identity().is_virtual(), drive }
    }
}

impl Link {
    /// Connects and makes sure that the drive speaks our protocol.
    ///
    /// # Errors
    /// No drive, several, or one that does not answer: with what to do.
    pub fn connect(&self) -> Result<Connected> {
        let drive = match &self.port {
            Some(address) => connect(address)?,
            None if self.virtual_drive => match background::find() {
                Some(address) => connect(&address)?,
                None => connect(&background::start(&[])?)?,
            },
            None => discover()?,
        };
        Ok(drive.into())
    }
}

fn connect(address: &str) -> Result<Drive, Error> {
    let patience = if address.starts_with("tcp://") { Patience::TCP } else { Patience::SERIAL };
    Drive::connect(Client::new(open(address)?, patience, random_id()))
}

fn discover() -> Result<Drive> {
    let mut found = serial_ports()?;
    found.extend(background::find().map(|address| (address, "virtual drive".to_owned())));
    let (address, what) = only(&found)?;
    eprintln!("using {address} ({what})");
    Ok(connect(address)?)
}

/// The one that there is: address and description.
fn only(found: &[(String, String)]) -> Result<&(String, String)> {
    match found {
        [one] => Ok(one),
        [] => bail!("no drive found\n  plug one in, name it with --port DEVICE, or try --virtual"),
        several => {
            let list: String = several.iter().map(|(address, what)| format!("\n  --port {address}   {what}")).collect();
            bail!("several drives may be meant: say which one{list}")
        }
    }
}

/// USB serial ports: address and description.
///
/// # Errors
/// The system does not tell.
pub fn serial_ports() -> Result<Vec<(String, String)>> {
    let ports = serialport::available_ports().context("asking the system for serial ports")?;
    let usb = ports.into_iter().filter_map(|port| match port.port_type {
        SerialPortType::UsbPort(usb) => Some((port.port_name, usb.product.unwrap_or_else(|| "USB".to_owned()))),
        _ => None,
    });
    Ok(usb.collect())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_single_drive_is_found_and_several_are_named() {
        let found = ["/dev/ttyACM0", "tcp://127.0.0.1:5025"].map(|address| (address.to_owned(), "a drive".to_owned()));
        assert_eq!(only(&found[..1]).unwrap(), &found[0]);
        assert!(only(&[]).unwrap_err().to_string().contains("--virtual"));
        let several = only(&found).unwrap_err().to_string();
        assert!(found.iter().all(|(address, _)| several.contains(&format!("--port {address}"))), "{several}");
    }
}
