//! The page and its WebSocket.

use std::net::SocketAddr;
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::{Arc, Mutex, PoisonError};

use anyhow::{Context, Result, ensure};
use axum::Router;
use axum::extract::ws::{Message, WebSocket, WebSocketUpgrade};
use axum::extract::{Query, State};
use axum::http::{HeaderMap, StatusCode, Uri, header};
use axum::response::{IntoResponse, Response};
use axum::routing::get;
use serde::Deserialize;
use tokio::net::TcpListener;
use tokio::sync::broadcast::error::RecvError;

use super::access::{Commander, Visitor, is_own_host, is_own_origin, is_token, random_token};
use super::assets::{ASSETS, PAGE};
use super::hub::Hub;
use super::news::{News, Wish};

/// Longest message from a browser, bytes.
const LONGEST_WISH: usize = 4096;
/// Nothing is loaded from elsewhere, and no other page may frame this one.
const POLICY: &str = "default-src 'self'; style-src 'self' 'unsafe-inline'; img-src 'self' data:; frame-ancestors 'none'; base-uri 'none'; form-action 'none'";

/// Where to serve, and to whom.
#[derive(Clone, Debug)]
pub struct Settings {
    /// Address; port 0 takes a free one.
    pub listen: SocketAddr,
    /// Token that other computers have to know; `None` serves this computer only.
    pub remote_token: Option<String>,
}

struct Server {
    hub: Hub,
    /// Of the page, for its WebSocket.
    token: String,
    listen: SocketAddr,
    remote_token: Option<String>,
    visitors: AtomicU64,
    commander: Mutex<Commander>,
}

/// Serves until the process ends. `announce` is told the page's address.
///
/// # Errors
/// An address that cannot be listened on, or that others reach although nobody said that they may.
pub async fn serve(hub: Hub, settings: Settings, announce: impl FnOnce(&str)) -> Result<()> {
    let Settings { listen, remote_token } = settings;
    ensure!(
        listen.ip().is_loopback() || remote_token.is_some(),
        "--listen {listen}: other computers can reach this address; --remote-token TOKEN says which ones may come in"
    );
    ensure!(
        remote_token.as_ref().is_none_or(|token| token.len() >= 16),
        "--remote-token: at least 16 characters, or it can be guessed"
    );
    let listener = TcpListener::bind(listen).await.with_context(|| format!("listening on {listen}"))?;
    let listen = listener.local_addr().context("the listening socket")?;
    let suffix = remote_token.as_ref().map_or(String::new(), |token| format!("?token={token}"));
    announce(&format!("http://{listen}/{suffix}"));
    let server = Server {
        hub,
        token: random_token(),
        listen,
        remote_token,
        visitors: AtomicU64::new(1),
        commander: Mutex::default(),
    };
    let app =
        Router::new().route("/", get(page)).route("/link", get(link)).fallback(asset).with_state(Arc::new(server));
    axum::serve(listener, app).await.context("serving the page")
}

#[derive(Deserialize)]
struct Tokens {
    token: Option<String>,
}

fn forbidden(why: &'static str) -> Response {
    (StatusCode::FORBIDDEN, why).into_response()
}

fn header_text(headers: &HeaderMap, name: header::HeaderName) -> &str {
    headers.get(name).and_then(|value| value.to_str().ok()).unwrap_or_default()
}

async fn page(State(server): State<Arc<Server>>, Query(tokens): Query<Tokens>, headers: HeaderMap) -> Response {
    if !is_own_host(header_text(&headers, header::HOST), server.listen) {
        return forbidden("this is not the address that servoctl serves");
    }
    let tried = tokens.token.unwrap_or_default();
    if server.remote_token.as_ref().is_some_and(|token| !is_token(token, &tried)) {
        return forbidden("this page needs its token: servoctl has printed the whole address");
    }
    let page = PAGE.replace("{{token}}", &server.token);
    answer("text/html; charset=utf-8", page)
}

async fn asset(State(server): State<Arc<Server>>, uri: Uri, headers: HeaderMap) -> Response {
    if !is_own_host(header_text(&headers, header::HOST), server.listen) {
        return forbidden("this is not the address that servoctl serves");
    }
    match ASSETS.iter().find(|(path, ..)| *path == uri.path()) {
        Some((_, media_type, content)) => answer(media_type, (*content).to_owned()),
        None => (StatusCode::NOT_FOUND, "no such page").into_response(),
    }
}

fn answer(media_type: &'static str, content: String) -> Response {
    let headers = [
        (header::CONTENT_TYPE, media_type),
        (header::CONTENT_SECURITY_POLICY, POLICY),
        (header::X_CONTENT_TYPE_OPTIONS, "nosniff"),
        (header::REFERRER_POLICY, "no-referrer"),
        (header::CACHE_CONTROL, "no-store"),
    ];
    (headers, content).into_response()
}

async fn link(
    State(server): State<Arc<Server>>,
    Query(tokens): Query<Tokens>,
    headers: HeaderMap,
    upgrade: WebSocketUpgrade,
) -> Response {
    let host = header_text(&headers, header::HOST);
    if !is_own_host(host, server.listen) || !is_own_origin(header_text(&headers, header::ORIGIN), host) {
        return forbidden("only the page that servoctl serves may connect");
    }
    if !is_token(&server.token, &tokens.token.unwrap_or_default()) {
        return forbidden("the page is of an earlier servoctl: load it again");
    }
    upgrade.max_message_size(LONGEST_WISH).on_upgrade(move |socket| attend(server, socket))
}

/// One browser, until it leaves.
async fn attend(server: Arc<Server>, mut socket: WebSocket) {
    let visitor = server.visitors.fetch_add(1, Ordering::Relaxed);
    let mut news = server.hub.listen();
    let greeting = &server.hub.greeting;
    let hello = News::Hello { drive: greeting.drive.clone(), simulated: greeting.simulated, you: visitor };
    let parameters = server.hub.parameters();
    let commander = News::Commander { holder: server.commander().holder() };
    let mut connected = true;
    for news in [hello, parameters, commander] {
        connected &= send(&mut socket, &news).await;
    }
    while connected {
        connected = tokio::select! {
            told = news.recv() => match told {
                Ok(text) => socket.send(Message::Text(text.as_ref().into())).await.is_ok(),
                // A browser that sleeps misses live traces and goes on with the newest.
                Err(RecvError::Lagged(_)) => true,
                Err(RecvError::Closed) => false,
            },
            wanted = socket.recv() => match wanted {
                Some(Ok(Message::Text(text))) => {
                    let (done, text) = match server.obey(visitor, &text).await {
                        Ok(text) => (true, text),
                        Err(text) => (false, text),
                    };
                    send(&mut socket, &News::Answer { done, text }).await
                }
                Some(Ok(Message::Close(_)) | Err(_)) | None => false,
                Some(Ok(_)) => true,
            },
        };
    }
    server.release(visitor);
}

async fn send(socket: &mut WebSocket, news: &News) -> bool {
    match serde_json::to_string(news) {
        Ok(text) => socket.send(Message::Text(text.into())).await.is_ok(),
        Err(_) => false,
    }
}

impl Server {
    fn commander(&self) -> std::sync::MutexGuard<'_, Commander> {
        // A thread that panicked while it held this has left it whole.
        self.commander.lock().unwrap_or_else(PoisonError::into_inner)
    }

    async fn obey(&self, visitor: Visitor, text: &str) -> Result<String, String> {
        let wish: Wish = serde_json::from_str(text).map_err(|error| format!("not understood: {error}"))?;
        match wish {
            Wish::Release => {
                self.release(visitor);
                Ok("another browser may command".to_owned())
            }
            // Whoever sees it go wrong may stop it.
            Wish::Stop => self.hub.order(wish).await,
            wish => {
                let before = self.commander().holder();
                self.commander().admit(visitor)?;
                if before.is_none() {
                    self.tell_commander();
                }
                self.hub.order(wish).await
            }
        }
    }

    fn release(&self, visitor: Visitor) {
        self.commander().release(visitor);
        self.tell_commander();
    }

    fn tell_commander(&self) {
        self.hub.tell(&News::Commander { holder: self.commander().holder() });
    }
}
