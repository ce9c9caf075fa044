//! HTTP and WebSocket: the page's files, and one conversation a page.

use std::sync::Arc;
use std::time::Duration;

use axum::Router;
use axum::body::Body;
use axum::extract::ws::{CloseFrame, Message, WebSocket, WebSocketUpgrade};
use axum::extract::{Request, State};
use axum::http::{HeaderMap, HeaderValue, StatusCode, header};
use axum::middleware::{self, Next};
use axum::response::{IntoResponse, Response};
use axum::routing::{any, get};
use servo_core::compensator::Compensator;
use servo_core::settling::TOLERANCES_NM;
use tokio::sync::broadcast::error::RecvError;
use tokio::sync::mpsc;
use tokio::time::MissedTickBehavior;

use super::access::Access;
use super::assets::ASSETS;
use super::hub::{Hub, Order};
use super::messages::{Action, FromPage, ToPage, table};

/// Longest message of a page, bytes.
const LONGEST_MESSAGE: usize = 4096;
/// How long a page may take to say who it is.
const HELLO: Duration = Duration::from_secs(5);
/// How often a page is asked whether it is there.
const PING: Duration = Duration::from_secs(1);
/// A page that has answered none of so many pings has gone. Pings, not seconds: a server that had no time itself has nobody to blame.
const SILENCE: u32 = 4;
/// Answers that may wait for a page.
const ANSWERS: usize = 32;
/// WebSocket close code for a broken rule of the server.
const POLICY: u16 = 1008;

/// What every request sees.
#[derive(Clone)]
pub struct Shared {
    /// Who may talk.
    pub access: Arc<Access>,
    /// Way to the drive.
    pub hub: Arc<Hub>,
}

/// The routes.
pub fn router(shared: Shared) -> Router {
    let mut router = Router::new();
    for asset in ASSETS {
        let answer = move || async move { ([(header::CONTENT_TYPE, asset.media_type)], asset.text) };
        router = router.route(asset.path, get(answer));
    }
    router.route("/ws", any(upgrade)).layer(middleware::from_fn_with_state(shared.clone(), guard)).with_state(shared)
}

/// Refuses what is not addressed to this server, and tells browsers to be strict with what is sent.
async fn guard(State(shared): State<Shared>, request: Request<Body>, next: Next) -> Response {
    let mut response = match shared.access.check_host(request.headers()) {
        Ok(()) => next.run(request).await,
        Err(reason) => (StatusCode::FORBIDDEN, reason).into_response(),
    };
    let rules = [
        // The page's own files and its own socket; nothing from elsewhere, nothing in line, no frame around it.
        (
            header::CONTENT_SECURITY_POLICY,
            "default-src 'self'; object-src 'none'; base-uri 'none'; form-action 'none'; frame-ancestors 'none'",
        ),
        (header::X_CONTENT_TYPE_OPTIONS, "nosniff"),
        (header::REFERRER_POLICY, "no-referrer"),
        (header::X_FRAME_OPTIONS, "DENY"),
        (header::CACHE_CONTROL, "no-store"),
        (header::HeaderName::from_static("cross-origin-resource-policy"), "same-origin"),
        (header::HeaderName::from_static("cross-origin-opener-policy"), "same-origin"),
    ];
    for (name, value) in rules {
        response.headers_mut().insert(name, HeaderValue::from_static(value));
    }
    response
}

async fn upgrade(State(shared): State<Shared>, headers: HeaderMap, socket: WebSocketUpgrade) -> Response {
    match shared.access.check_origin(&headers) {
        Ok(()) => socket.max_message_size(LONGEST_MESSAGE).on_upgrade(move |socket| greet(shared, socket)),
        Err(reason) => (StatusCode::FORBIDDEN, reason).into_response(),
    }
}

/// A page is heard once it has shown the token; before, it is told nothing.
async fn greet(shared: Shared, mut socket: WebSocket) {
    let first = tokio::time::timeout(HELLO, socket.recv()).await;
    let hello = match first {
        Ok(Some(Ok(Message::Text(text)))) => serde_json::from_str::<FromPage>(&text).ok(),
        _ => None,
    };
    if hello.is_some_and(|hello| hello.action == Action::Hello && shared.access.knows(&hello.token)) {
        talk(&shared, socket).await;
    } else {
        let reason = "the token is missing or old: open the address that servoctl prints";
        let _ = socket.send(Message::Close(Some(CloseFrame { code: POLICY, reason: reason.into() }))).await;
    }
}

/// Everything a page and the server say to each other.
async fn talk(shared: &Shared, mut socket: WebSocket) {
    let (page, mut news) = shared.hub.join();
    let (sender, mut answers) = mpsc::channel::<Arc<str>>(ANSWERS);
    let mut ping = tokio::time::interval(PING);
    ping.set_missed_tick_behavior(MissedTickBehavior::Delay);
    let (mut unanswered, mut dropped) = (0, 0);
    let mut waiting: Vec<Arc<str>> = vec![welcome(page).to_json().into()];
    waiting.extend(shared.hub.known());
    loop {
        let mut broken = false;
        for text in waiting.drain(..) {
            broken |= socket.send(Message::Text((*text).into())).await.is_err();
        }
        if broken {
            break;
        }
        tokio::select! {
            // What the page has said comes before the question whether it is there.
            biased;
            message = socket.recv() => {
                unanswered = 0;
                match message {
                    Some(Ok(Message::Text(text))) => match read(shared, page, &text, &sender) {
                        Ok(answer) => waiting.extend(answer.map(|answer| answer.to_json().into())),
                        Err(reason) => {
                            let close = CloseFrame { code: POLICY, reason: reason.into() };
                            let _ = socket.send(Message::Close(Some(close))).await;
                            break;
                        }
                    },
                    Some(Ok(Message::Close(_)) | Err(_)) | None => break,
                    Some(Ok(_)) => {}
                }
            }
            answer = answers.recv() => waiting.extend(answer),
            _ = ping.tick() => {
                if unanswered == SILENCE || socket.send(Message::Ping(Default::default())).await.is_err() {
                    break;
                }
                unanswered += 1;
            }
            text = news.recv() => match text {
                Ok(text) => waiting.push(text),
                Err(RecvError::Lagged(messages)) => {
                    dropped += messages;
                    waiting.push(ToPage::Dropped { messages: dropped }.to_json().into());
                    waiting.extend(shared.hub.known());
                }
                Err(RecvError::Closed) => break,
            },
        }
    }
    shared.hub.leave(page);
}

/// Does what a page says; `Ok(None)`: the drive's thread will answer.
///
/// # Errors
/// Why this page is not talked to any longer.
fn read(
    shared: &Shared,
    page: u64,
    text: &str,
    sender: &mpsc::Sender<Arc<str>>,
) -> Result<Option<ToPage>, &'static str> {
    let Ok(FromPage { token, id, action }) = serde_json::from_str(text) else {
        return Err("a message that means nothing here: reload the page");
    };
    if !shared.access.knows(&token) {
        return Err("a message without the token");
    }
    let done = Some(ToPage::Answer { id, error: None });
    Ok(match action {
        Action::Hello => done,
        Action::TakeOver => {
            shared.hub.take_over(page);
            done
        }
        Action::Stop => {
            shared.hub.stop();
            done
        }
        action => {
            let order = Order { action, id, answers: sender.clone() };
            shared.hub.order(page, order).err().map(|reason| ToPage::Answer { id, error: Some(reason) })
        }
    })
}

fn welcome(page: u64) -> ToPage {
    ToPage::Welcome {
        page,
        servo_hz: servo_core::SERVO_HZ,
        tolerances_nm: TOLERANCES_NM,
        compensators: Compensator::ALL.iter().map(|compensator| compensator.name()).collect(),
        table: table(),
    }
}
