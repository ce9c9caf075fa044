//! The serial link: USART3 to the ST-LINK's virtual COM port, interrupt-driven ring buffers.

use embassy_stm32::usart::{
    BufferedInterruptHandler, BufferedUart, BufferedUartRx, BufferedUartTx, Config, ConfigError,
};
use embassy_stm32::{Peri, bind_interrupts, peripherals};
use static_cell::ConstStaticCell;

/// Bits per second; 8 data bits, no parity, one stop bit.
///
/// Four signals of every servo tick take 1.4 Mbit/s. The clock's nearest rate is 1 % faster.
pub const BAUD: u32 = 3_000_000;

/// Bytes to the host: implements the `embedded-io-async` traits.
pub type LinkSender = BufferedUartTx<'static>;
/// Bytes from the host: implements the `embedded-io-async` traits.
pub type LinkReceiver = BufferedUartRx<'static>;

bind_interrupts!(struct Interrupts {
    USART3 => BufferedInterruptHandler<peripherals::USART3>;
});

pub fn open(
    usart: Peri<'static, peripherals::USART3>,
    rx: Peri<'static, peripherals::PD9>,
    tx: Peri<'static, peripherals::PD8>,
) -> Result<(LinkSender, LinkReceiver), ConfigError> {
    static TX: ConstStaticCell<[u8; 1024]> = ConstStaticCell::new([0; 1024]);
    static RX: ConstStaticCell<[u8; 1024]> = ConstStaticCell::new([0; 1024]);
    let mut config = Config::default();
    config.baudrate = BAUD;
    Ok(BufferedUart::new(usart, rx, tx, TX.take(), RX.take(), Interrupts, config)?.split())
}
