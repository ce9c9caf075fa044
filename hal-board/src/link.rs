//! The serial link: USART3 to the ST-LINK's virtual COM port, interrupt-driven ring buffers.

use embassy_stm32::usart::{BufferedInterruptHandler, BufferedUart, Config, ConfigError};
use embassy_stm32::{Peri, bind_interrupts, peripherals};
use static_cell::ConstStaticCell;

/// Bits per second; 8 data bits, no parity, one stop bit.
pub const BAUD: u32 = 921_600;

/// Byte stream to the host: implements the `embedded-io-async` traits.
pub type Link = BufferedUart<'static>;

bind_interrupts!(struct Interrupts {
    USART3 => BufferedInterruptHandler<peripherals::USART3>;
});

pub fn open(
    usart: Peri<'static, peripherals::USART3>,
    rx: Peri<'static, peripherals::PD9>,
    tx: Peri<'static, peripherals::PD8>,
) -> Result<Link, ConfigError> {
    static TX: ConstStaticCell<[u8; 1024]> = ConstStaticCell::new([0; 1024]);
    static RX: ConstStaticCell<[u8; 1024]> = ConstStaticCell::new([0; 1024]);
    let mut config = Config::default();
    config.baudrate = BAUD;
    BufferedUart::new(usart, rx, tx, TX.take(), RX.take(), Interrupts, config)
}
