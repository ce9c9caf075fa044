//! Where pages and the drive's thread meet: news to every page, orders from the one that commands.

use std::collections::VecDeque;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::sync::mpsc::{Receiver, SyncSender, sync_channel};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

use tokio::sync::{broadcast, mpsc};

use super::messages::{Action, ToPage};

/// Orders that may wait for the drive's thread; one more is refused.
const ORDERS: usize = 16;
/// News that may wait for a page; a slower page loses the oldest, and is told how many.
const NEWS: usize = 256;
/// Captures that a new page is shown.
const CAPTURES: usize = 4;

/// What a page wants of the drive.
pub struct Order {
    /// What is wanted.
    pub action: Action,
    /// The page's number for it.
    pub id: u32,
    /// Way back to the page.
    pub answers: mpsc::Sender<Arc<str>>,
}

impl Order {
    /// Tells the page how it ended. A page that does not read its answers misses this one.
    pub fn answer(&self, result: Result<(), String>) {
        let answer = ToPage::Answer { id: self.id, error: result.err() };
        let _ = self.answers.try_send(answer.to_json().into());
    }
}

/// What wakes the drive's thread before its next look at the drive.
pub enum Wake {
    /// Something to do.
    Order {
        /// What.
        order: Order,
        /// Stops that there had been when it was given, see [`Hub::is_stopped`].
        stops: u64,
    },
    /// Look at the flags.
    Look,
}

/// The meeting place.
pub struct Hub {
    news: broadcast::Sender<Arc<str>>,
    orders: SyncSender<Wake>,
    stop: AtomicBool,
    left: AtomicBool,
    /// Stops so far, those included that a page leaves behind.
    stops: AtomicU64,
    end: AtomicBool,
    table: Mutex<Table>,
}

/// Who is there, and what a new page must know.
#[derive(Default)]
struct Table {
    /// In the order of arrival.
    pages: Vec<u64>,
    last_page: u64,
    commander: Option<u64>,
    link: Option<Arc<str>>,
    parameters: Option<Arc<str>>,
    moves: Option<Arc<str>>,
    status: Option<Arc<str>>,
    captures: VecDeque<Arc<str>>,
}

impl Hub {
    /// A meeting place, and the drive's end of its queue.
    pub fn new() -> (Arc<Self>, Receiver<Wake>) {
        let (orders, receiver) = sync_channel(ORDERS);
        let (news, _) = broadcast::channel(NEWS);
        let flag = || AtomicBool::new(false);
        let stops = AtomicU64::new(0);
        let hub = Hub { news, orders, stop: flag(), left: flag(), stops, end: flag(), table: Mutex::default() };
        (Arc::new(hub), receiver)
    }

    fn table(&self) -> MutexGuard<'_, Table> {
        // Plain values: whoever panicked left nothing half-done that matters.
        self.table.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Tells every page, and remembers what a page that comes later must know.
    pub fn publish(&self, message: &ToPage) {
        let text: Arc<str> = message.to_json().into();
        let mut table = self.table();
        match message {
            ToPage::Link { .. } => table.link = Some(text.clone()),
            ToPage::Parameters { .. } => table.parameters = Some(text.clone()),
            ToPage::Moves { .. } => table.moves = Some(text.clone()),
            ToPage::Status(_) => table.status = Some(text.clone()),
            ToPage::Capture(_) => {
                if table.captures.len() == CAPTURES {
                    table.captures.pop_front();
                }
                table.captures.push_back(text.clone());
            }
            _ => {}
        }
        // Under the lock, so that a page finds it either in what it is shown first or in the news. Nobody there is no error.
        let _ = self.news.send(text);
    }

    /// A page is there: its number, what it must know, and the news from then on. The first one commands.
    pub fn join(&self) -> (u64, broadcast::Receiver<Arc<str>>) {
        let mut table = self.table();
        table.last_page += 1;
        let page = table.last_page;
        table.pages.push(page);
        table.commander.get_or_insert(page);
        let news = self.news.subscribe();
        drop(table);
        self.publish_role();
        (page, news)
    }

    /// What a page must know that has seen nothing, or has lost news.
    pub fn known(&self) -> Vec<Arc<str>> {
        let table = self.table();
        let role = role(&table).to_json().into();
        let single = [&table.link, &table.parameters, &table.moves];
        let before = single.into_iter().flatten().chain(&table.captures).chain(&table.status);
        [role].into_iter().chain(before.cloned()).collect()
    }

    /// A page has gone. If it commanded, the drive is stopped and the page that came next commands.
    pub fn leave(&self, page: u64) {
        let mut table = self.table();
        table.pages.retain(|other| *other != page);
        if table.commander == Some(page) {
            table.commander = table.pages.first().copied();
            self.stops.fetch_add(1, Ordering::AcqRel);
            self.left.store(true, Ordering::Release);
        }
        drop(table);
        self.wake();
        self.publish_role();
    }

    /// This page commands from now on.
    pub fn take_over(&self, page: u64) {
        self.table().commander = Some(page);
        self.publish_role();
    }

    /// Hands an order to the drive's thread, which answers it.
    ///
    /// # Errors
    /// Why it never got there.
    pub fn order(&self, page: u64, order: Order) -> Result<(), String> {
        match self.table().commander {
            Some(commander) if commander == page => {}
            Some(commander) => {
                return Err(format!("page {commander} commands, this is page {page}: take over first"));
            }
            None => return Err("nobody commands: take over first".to_owned()),
        }
        let full = "too many orders at once: this one was dropped";
        let stops = self.stops.load(Ordering::Acquire);
        self.orders.try_send(Wake::Order { order, stops }).map_err(|_| full.to_owned())
    }

    /// Brakes the drive to rest, before anything else that waits, and in place of it.
    pub fn stop(&self) {
        self.stops.fetch_add(1, Ordering::AcqRel);
        self.stop.store(true, Ordering::Release);
        self.wake();
    }

    /// The server ends: the drive's thread brakes what moves and returns.
    pub fn end(&self) {
        self.end.store(true, Ordering::Release);
        self.wake();
    }

    /// Somebody wants the drive to stop; asked once.
    pub fn take_stop(&self) -> bool {
        self.stop.swap(false, Ordering::AcqRel)
    }

    /// An order that was given when there had been so many `stops` is not to be carried out any more.
    pub fn is_stopped(&self, stops: u64) -> bool {
        stops != self.stops.load(Ordering::Acquire)
    }

    /// The page that commanded has gone; asked once.
    pub fn take_left(&self) -> bool {
        self.left.swap(false, Ordering::AcqRel)
    }

    /// The server ends.
    pub fn ends(&self) -> bool {
        self.end.load(Ordering::Acquire)
    }

    fn wake(&self) {
        // A full queue wakes the thread as well.
        let _ = self.orders.try_send(Wake::Look);
    }

    fn publish_role(&self) {
        let role = role(&self.table());
        self.publish(&role);
    }
}

fn role(table: &Table) -> ToPage {
    ToPage::Role { commander: table.commander, pages: table.pages.len() }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn order(id: u32) -> (Order, mpsc::Receiver<Arc<str>>) {
        let (answers, receiver) = mpsc::channel(1);
        (Order { action: Action::Enable, id, answers }, receiver)
    }

    #[test]
    fn the_first_page_commands_and_the_second_is_told_why_it_does_not() {
        let (hub, _orders) = Hub::new();
        let (first, second) = (hub.join().0, hub.join().0);
        assert_eq!(hub.order(first, order(1).0), Ok(()));
        assert_eq!(hub.order(second, order(1).0).unwrap_err(), "page 1 commands, this is page 2: take over first");
        hub.take_over(second);
        assert!(hub.order(first, order(2).0).is_err() && hub.order(second, order(2).0).is_ok());
    }

    #[test]
    fn when_the_commander_leaves_the_drive_is_stopped_and_the_next_one_commands() {
        let (hub, _orders) = Hub::new();
        let (first, second) = (hub.join().0, hub.join().0);
        hub.leave(second);
        assert!(!hub.take_left(), "a page that only looked on");
        let third = hub.join().0;
        hub.leave(first);
        assert!(hub.take_left() && !hub.take_left());
        assert_eq!(hub.order(third, order(1).0), Ok(()));
    }

    #[test]
    fn orders_are_bounded_and_what_does_not_fit_is_said() {
        let (hub, orders) = Hub::new();
        let page = hub.join().0;
        let sent = (0..100).filter(|id| hub.order(page, order(*id).0).is_ok()).count();
        assert_eq!(sent, ORDERS);
        assert_eq!(orders.try_iter().count(), ORDERS);
        assert!(hub.order(page, order(0).0).is_ok());
        // A stop needs no place in the queue.
        hub.stop();
        assert!(hub.take_stop() && !hub.take_stop());
    }

    #[test]
    fn a_stop_overtakes_the_orders_that_wait_and_not_those_after_it() {
        let (hub, orders) = Hub::new();
        let (first, second) = (hub.join().0, hub.join().0);
        let waiting = |hub: &Hub| {
            let stopped = orders.try_iter().filter_map(|wake| match wake {
                Wake::Order { order, stops } => Some((order.id, hub.is_stopped(stops))),
                Wake::Look => None,
            });
            stopped.collect::<Vec<_>>()
        };
        hub.order(first, order(1).0).unwrap();
        hub.order(first, order(2).0).unwrap();
        hub.stop();
        hub.order(first, order(3).0).unwrap();
        assert_eq!(waiting(&hub), [(1, true), (2, true), (3, false)]);
        // So does the end of the page that commanded; that of another one does not.
        hub.order(first, order(4).0).unwrap();
        hub.leave(second);
        assert_eq!(waiting(&hub), [(4, false)]);
        let third = hub.join().0;
        hub.order(first, order(5).0).unwrap();
        hub.leave(first);
        hub.order(third, order(6).0).unwrap();
        assert_eq!(waiting(&hub), [(5, true), (6, false)]);
    }

    #[test]
    fn a_slow_page_loses_the_oldest_news_and_learns_how_many() {
        let (hub, _orders) = Hub::new();
        let (_, mut news) = hub.join();
        while news.try_recv().is_ok() {}
        for _ in 0..NEWS + 7 {
            hub.publish(&ToPage::Notice { text: String::new() });
        }
        assert_eq!(news.try_recv().unwrap_err(), broadcast::error::TryRecvError::Lagged(7));
        assert_eq!(std::iter::from_fn(|| news.try_recv().ok()).count(), NEWS);
    }

    #[test]
    fn a_late_page_is_shown_the_last_of_everything() {
        let (hub, _orders) = Hub::new();
        let parameters = |hash: &str| ToPage::Parameters { values: vec![1.0], unsaved: None, hash: hash.to_owned() };
        hub.publish(&parameters("old"));
        hub.publish(&parameters("new"));
        hub.publish(&ToPage::Notice { text: "gone".to_owned() });
        hub.join();
        let known = hub.known().join("\n");
        assert!(known.contains("new") && !known.contains("old") && !known.contains("gone"), "{known}");
        assert!(known.contains(r#""commander":1,"pages":1"#), "{known}");
    }
}
