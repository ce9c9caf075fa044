//! The serial link: USART3 to the ST-LINK's virtual COM port, interrupt-driven ring buffers.

use embassy_stm32::usart::{
    BufferedInterruptHandler, BufferedUart, BufferedUartRx, BufferedUartTx, Config, ConfigError, Error,
};
use embassy_stm32::{Peri, bind_interrupts, peripherals};
use embedded_io_async::Write;
use static_cell::ConstStaticCell;

/// Bits per second; 8 data bits, no parity, one stop bit.
///
/// Four signals of every servo tick take 1.4 Mbit/s. The clock's nearest rate is 1 % faster.
pub const BAUD: u32 = 3_000_000;

/// Bytes to the host.
pub struct LinkSender(BufferedUartTx<'static>);

impl LinkSender {
    /// Takes all of `bytes`, at most `RING`, once those before them are out.
    ///
    /// That wait is the point of this type: a write of embassy-stm32 0.6.0 whose bytes do not fit into the ring returns `Pending` without
    /// having registered a waker (`usart/buffered.rs`), so that nobody ever wakes it. Into an empty ring they fit.
    ///
    /// # Errors
    /// More bytes than `RING`; none of them is sent.
    pub async fn send(&mut self, bytes: &[u8]) -> Result<(), Error> {
        self.0.flush().await?;
        self.0.write_all(bytes).await
    }
}

/// Bytes from the host: implements the `embedded-io-async` traits.
pub type LinkReceiver = BufferedUartRx<'static>;

/// Size of the rings in either direction, bytes.
pub const RING: usize = 1024;

bind_interrupts!(struct Interrupts {
    USART3 => BufferedInterruptHandler<peripherals::USART3>;
});

pub fn open(
    usart: Peri<'static, peripherals::USART3>,
    rx: Peri<'static, peripherals::PD9>,
    tx: Peri<'static, peripherals::PD8>,
) -> Result<(LinkSender, LinkReceiver), ConfigError> {
    static TX: ConstStaticCell<[u8; RING]> = ConstStaticCell::new([0; RING]);
    static RX: ConstStaticCell<[u8; RING]> = ConstStaticCell::new([0; RING]);
    let mut config = Config::default();
    config.baudrate = BAUD;
    let (tx, rx) = BufferedUart::new(usart, rx, tx, TX.take(), RX.take(), Interrupts, config)?.split();
    Ok((LinkSender(tx), rx))
}
