//! The server: one page, one WebSocket, uploads and downloads. It holds faces of patients: it answers only who knows its token, only
//! under its own address, and only to its own page.

use std::net::{IpAddr, Ipv4Addr, Ipv6Addr, SocketAddr};
use std::path::Path as FilePath;
use std::sync::Arc;
use std::time::Duration;

use axum::Router;
use axum::body::{Body, Bytes};
use axum::extract::rejection::{PathRejection, QueryRejection};
use axum::extract::ws::{Message, WebSocket, WebSocketUpgrade};
use axum::extract::{Path, Query, Request, State};
use axum::http::header::{self, HeaderMap, HeaderName, HeaderValue};
use axum::http::{Method, StatusCode};
use axum::middleware::{self, Next};
use axum::response::{IntoResponse, Response};
use axum::routing::{get, post};
use axum::serve::ListenerExt as _;
use futures_util::{SinkExt as _, StreamExt as _};
use serde::Deserialize;
use tokio::io::AsyncWriteExt as _;
use tokio::net::TcpListener;

use crate::case::FileRef;
use crate::error::{Problem, problem};
use crate::protocol::{FromPage, ServerMessage};
use crate::session::{self, Hub, Inbox, Outgoing};
use crate::vault::{LARGEST_FILE, check_name, random_name};

/// The bundled page: path and contents.
static PAGE: &[(&str, &[u8])] = include!(concat!(env!("OUT_DIR"), "/page.rs"));

/// Largest message of the page, bytes: a painted mask of a million vertices.
const LARGEST_MESSAGE: usize = 16 << 20;
/// Messages to a page that may wait.
const WAITING: usize = 256;

/// A server that listens.
pub struct Server {
    listener: TcpListener,
    gate: Arc<Gate>,
}

/// Who may come in.
struct Gate {
    hub: Arc<Hub>,
    token: String,
    cookie: String,
    port: u16,
    /// Names and addresses that it is called by, without the port.
    hosts: Vec<String>,
    /// Whether it is called by any address: it listens on all of them. A page of another site that has its name lead here comes by name.
    any_address: bool,
}

impl Server {
    /// Listens; port 0 takes a free one.
    ///
    /// # Errors
    /// When the address is taken or is not this machine's.
    pub async fn bind(hub: Arc<Hub>, host: IpAddr, port: u16) -> Result<Self, Problem> {
        let busy = |e| problem(format!("cannot listen on {host} port {port}: {e}; choose another one with --port"));
        let listener = TcpListener::bind(SocketAddr::new(host, port)).await.map_err(busy)?;
        let port = listener.local_addr()?.port();
        let any_address = host.is_unspecified();
        // where it listens on all addresses, this machine's browser takes the one that never leaves it
        let own = match host {
            IpAddr::V4(_) if any_address => Ipv4Addr::LOCALHOST.into(),
            IpAddr::V6(_) if any_address => Ipv6Addr::LOCALHOST.into(),
            _ => host,
        };
        let mut hosts = vec![if own.is_ipv6() { format!("[{own}]") } else { own.to_string() }];
        if own.is_loopback() {
            hosts.push("localhost".to_owned());
        }
        if any_address {
            hosts.extend(names_of_this_machine());
        }
        // browsers keep one cookie for all ports of a host
        let cookie = format!("nonrigid_studio_{port}");
        Ok(Self { listener, gate: Arc::new(Gate { hub, token: random_name()?, cookie, port, hosts, any_address }) })
    }

    /// Its address, with the token.
    #[must_use]
    pub fn address(&self) -> String {
        let Gate { hosts, port, token, .. } = &*self.gate;
        format!("http://{}:{port}/?token={token}", hosts[0])
    }

    /// The names of this machine under which it answers others, where it listens on all of its addresses.
    #[must_use]
    pub fn names(&self) -> Option<&[String]> {
        // the first two are for this machine alone
        self.gate.any_address.then(|| &self.gate.hosts[2..])
    }

    /// Serves until the process ends.
    ///
    /// # Errors
    /// When the system takes the listener away.
    pub async fn run(self) -> Result<(), Problem> {
        let Self { listener, gate } = self;
        tokio::spawn(watch(gate.hub.clone()));
        let routes = Router::new()
            .route("/socket", get(socket))
            .route("/upload", post(upload))
            .route("/files/{asset}/{file}", get(download))
            .fallback(get(page))
            .layer(middleware::from_fn_with_state(gate.clone(), guard))
            .with_state(gate);
        // The small message after a large one would wait for the page's system to confirm that: up to 40 ms in each frame of a drag.
        let listener = listener.tap_io(|stream| drop(stream.set_nodelay(true)));
        axum::serve(listener, routes).await?;
        Ok(())
    }
}

/// Tells windows when another program has changed the vault.
async fn watch(hub: Arc<Hub>) {
    let mut known = None;
    loop {
        tokio::time::sleep(Duration::from_millis(700)).await;
        let reading = hub.clone();
        let version = tokio::task::spawn_blocking(move || reading.vault.foreign_version().ok()).await.ok().flatten();
        if known.is_some() && version != known {
            hub.tell(None);
        }
        known = version;
    }
}

/// Texts of equal length are compared in the same time wherever they differ.
fn same(a: &str, b: &str) -> bool {
    a.len() == b.len() && a.bytes().zip(b.bytes()).fold(0, |differ, (a, b)| differ | (a ^ b)) == 0
}

fn text(headers: &HeaderMap, name: HeaderName) -> Option<&str> {
    headers.get(name)?.to_str().ok()
}

/// As `hostname` says, also in the local network; none where there is no such program.
fn names_of_this_machine() -> Vec<String> {
    let out = std::process::Command::new("hostname").output();
    let name = out.map_or_else(|_| String::new(), |out| String::from_utf8_lossy(&out.stdout).trim().to_lowercase());
    let plain = !name.is_empty() && name.chars().all(|c| c.is_ascii_alphanumeric() || "-.".contains(c));
    if plain { vec![format!("{name}.local"), name] } else { Vec::new() }
}

impl Gate {
    /// Whether a `Host` is one that it is called by.
    fn is_own(&self, host: &str) -> bool {
        let named = host.strip_suffix(&format!(":{}", self.port));
        // browsers leave the usual port out
        let Some(name) = named.or_else(|| (self.port == 80).then_some(host)) else { return false };
        let literal = || match name.strip_prefix('[').and_then(|name| name.strip_suffix(']')) {
            Some(name) => name.parse::<Ipv6Addr>().is_ok(),
            None => name.parse::<Ipv4Addr>().is_ok(),
        };
        self.hosts.iter().any(|own| own.eq_ignore_ascii_case(name)) || (self.any_address && literal())
    }

    fn knows(&self, headers: &HeaderMap) -> bool {
        let cookies = headers.get_all(header::COOKIE).iter().filter_map(|c| c.to_str().ok()).flat_map(|c| c.split(';'));
        let mut values = cookies.filter_map(|c| c.trim().split_once('=')).filter(|(name, _)| *name == self.cookie);
        values.any(|(_, value)| same(value, &self.token))
    }

    /// A page of another site can neither read answers nor make changes: what it sends names where it comes from.
    fn own_origin(&self, headers: &HeaderMap, needed: bool) -> bool {
        match text(headers, header::ORIGIN) {
            Some(origin) => {
                text(headers, header::HOST).is_some_and(|host| origin.strip_prefix("http://") == Some(host))
            }
            None => !needed && !headers.contains_key(header::ORIGIN),
        }
    }
}

/// What a query asks for. One that is not as the page writes it is answered in the program's own words.
type Asked<T> = Result<Query<T>, QueryRejection>;

#[derive(Deserialize)]
struct Token {
    token: Option<String>,
}

fn refused(status: StatusCode, why: &'static str) -> Response {
    (status, why).into_response()
}

/// What every request has to pass.
async fn guard(State(gate): State<Arc<Gate>>, query: Asked<Token>, request: Request, next: Next) -> Response {
    let given = query.ok().and_then(|Query(Token { token })| token);
    let headers = request.headers();
    let host = text(headers, header::HOST).filter(|host| gate.is_own(host)).map(str::to_owned);
    let mut response = if host.is_none() {
        let why = "This server answers only under its own address: the one that it has printed, or a number where it listens on all.";
        refused(StatusCode::MISDIRECTED_REQUEST, why)
    } else if request.uri().path() == "/" && given.is_some_and(|token| same(&token, &gate.token)) {
        // the token leaves the address bar and the history
        let cookie = format!("{}={}; HttpOnly; SameSite=Strict; Path=/", gate.cookie, gate.token);
        let mut response = (StatusCode::SEE_OTHER, [(header::LOCATION, "/")]).into_response();
        response.headers_mut().extend(HeaderValue::from_str(&cookie).map(|c| (header::SET_COOKIE, c)));
        response
    } else if !gate.knows(headers) {
        refused(StatusCode::UNAUTHORIZED, "Open the address that the program has printed, with its token.")
    } else if !gate.own_origin(
        headers,
        !matches!(*request.method(), Method::GET | Method::HEAD) || request.uri().path() == "/socket",
    ) {
        refused(StatusCode::FORBIDDEN, "This request comes from another page.")
    } else {
        next.run(request).await
    };
    let headers = response.headers_mut();
    let socket = host.map_or_else(String::new, |host| format!(" ws://{host}"));
    let policy = format!(
        "default-src 'none'; script-src 'self'; style-src 'self'; img-src 'self' blob: data:; connect-src 'self'{socket}; \
         base-uri 'none'; form-action 'none'; frame-ancestors 'none'"
    );
    headers.extend(HeaderValue::from_str(&policy).map(|p| (header::CONTENT_SECURITY_POLICY, p)));
    for (name, value) in [
        (header::X_CONTENT_TYPE_OPTIONS, "nosniff"),
        (header::REFERRER_POLICY, "no-referrer"),
        (header::CACHE_CONTROL, "no-store"),
        (HeaderName::from_static("cross-origin-resource-policy"), "same-origin"),
        (HeaderName::from_static("cross-origin-opener-policy"), "same-origin"),
    ] {
        headers.insert(name, HeaderValue::from_static(value));
    }
    response
}

const NOTHING: &str = "There is nothing here.";

/// The page and its parts.
async fn page(request: Request) -> Response {
    let path = request.uri().path().trim_start_matches('/');
    let path = if path.is_empty() { "index.html" } else { path };
    let Some((_, bytes)) = PAGE.iter().find(|(known, _)| *known == path) else {
        return refused(StatusCode::NOT_FOUND, NOTHING);
    };
    let kind = match FilePath::new(path).extension().and_then(|e| e.to_str()) {
        Some("html") => "text/html; charset=utf-8",
        Some("js") => "text/javascript",
        Some("css") => "text/css",
        Some("svg") => "image/svg+xml",
        _ => "application/octet-stream",
    };
    ([(header::CONTENT_TYPE, kind)], Bytes::from_static(bytes)).into_response()
}

fn failed(status: StatusCode, problem: Problem) -> Response {
    (status, problem.0).into_response()
}

/// A file of the vault; pictures are shown, everything else is saved.
async fn download(State(gate): State<Arc<Gate>>, path: Result<Path<(String, String)>, PathRejection>) -> Response {
    let Ok(Path((asset, file))) = path else { return refused(StatusCode::NOT_FOUND, NOTHING) };
    let path = match check_name(&file).and_then(|()| gate.hub.vault.path(&FileRef { asset, file: file.clone() })) {
        Ok(path) => path,
        Err(problem) => return failed(StatusCode::NOT_FOUND, problem),
    };
    let opened = match tokio::fs::File::open(path).await {
        Ok(opened) => opened,
        Err(error) => return failed(StatusCode::NOT_FOUND, error.into()),
    };
    let extension = file.rsplit('.').next().unwrap_or_default().to_lowercase();
    let picture = match extension.as_str() {
        "png" => Some("image/png"),
        "jpg" | "jpeg" => Some("image/jpeg"),
        "webp" => Some("image/webp"),
        _ => None,
    };
    let stream = futures_util::stream::unfold(opened, |mut file| async move {
        let mut buffer = vec![0; 1 << 16];
        match tokio::io::AsyncReadExt::read(&mut file, &mut buffer).await {
            Ok(0) => None,
            Ok(read) => {
                buffer.truncate(read);
                Some((Ok(Bytes::from(buffer)), file))
            }
            Err(error) => Some((Err(error), file)),
        }
    });
    let kind = picture.unwrap_or("application/octet-stream");
    let ascii: String =
        file.chars().map(|c| if c.is_ascii_alphanumeric() || "-_.".contains(c) { c } else { '_' }).collect();
    // names beyond ASCII as RFC 6266 has them
    let coded: String = file.bytes().fold(String::new(), |coded, byte| match byte {
        b if b.is_ascii_alphanumeric() || b"-_.".contains(&b) => coded + &char::from(b).to_string(),
        b => coded + &format!("%{b:02X}"),
    });
    let save = match picture {
        Some(_) => "inline".to_owned(),
        None => format!("attachment; filename=\"{ascii}\"; filename*=UTF-8''{coded}"),
    };
    ([(header::CONTENT_TYPE, kind.to_owned()), (header::CONTENT_DISPOSITION, save)], Body::from_stream(stream))
        .into_response()
}

#[derive(Deserialize)]
struct Name {
    name: String,
}

/// Takes a file until a message says what it is.
async fn upload(State(gate): State<Arc<Gate>>, query: Asked<Name>, body: Body) -> Response {
    let Ok(Query(Name { name })) = query else {
        return refused(StatusCode::BAD_REQUEST, "A file comes with its name, once, in UTF-8.");
    };
    match receive(&gate.hub, &name, body).await {
        Ok(id) => id.into_response(),
        Err(problem) => failed(StatusCode::BAD_REQUEST, problem),
    }
}

async fn receive(hub: &Arc<Hub>, name: &str, body: Body) -> Result<String, Problem> {
    check_name(name)?;
    let incoming = hub.vault.incoming()?;
    let mut file = tokio::fs::File::create(incoming.folder.join(name)).await?;
    let mut stream = body.into_data_stream();
    let mut length = 0;
    while let Some(chunk) = stream.next().await {
        let chunk = chunk.map_err(|e| problem(format!("{name}: it did not arrive whole: {e}")))?;
        length += chunk.len() as u64;
        if length > LARGEST_FILE {
            return Err(problem(format!("{name}: larger than {} GB; decimate it first", LARGEST_FILE >> 30)));
        }
        file.write_all(&chunk).await?;
    }
    file.flush().await?;
    Ok(hub.keep_upload(incoming))
}

#[derive(Deserialize)]
struct Shown {
    client: Option<u32>,
}

async fn socket(State(gate): State<Arc<Gate>>, query: Asked<Shown>, upgrade: WebSocketUpgrade) -> Response {
    let Ok(Query(Shown { client })) = query else {
        return refused(StatusCode::BAD_REQUEST, "A client has one number.");
    };
    upgrade
        .max_message_size(LARGEST_MESSAGE)
        .max_frame_size(LARGEST_MESSAGE)
        .on_upgrade(move |socket| window(gate.hub.clone(), socket, client))
}

async fn window(hub: Arc<Hub>, socket: WebSocket, client: Option<u32>) {
    let (mut sink, mut stream) = socket.split();
    let (page, mut outgoing) = tokio::sync::mpsc::channel(WAITING);
    let to_window = session::open(&hub, page.clone(), client);
    let writer = tokio::spawn(async move {
        while let Some(message) = outgoing.recv().await {
            let message = match message {
                Outgoing::Message(message) => Message::text(serde_json::to_string(&message).unwrap_or_default()),
                Outgoing::Frame(bytes) => Message::binary(bytes),
            };
            if sink.send(message).await.is_err() {
                break;
            }
        }
    });
    while let Some(Ok(message)) = stream.next().await {
        let message = match message {
            Message::Text(text) => serde_json::from_str::<FromPage>(&text).ok(),
            Message::Binary(_) => None,
            Message::Close(_) => break,
            Message::Ping(_) | Message::Pong(_) => continue,
        };
        match message {
            Some(message) => {
                if to_window.send(Inbox::Page(Box::new(message))).is_err() {
                    break;
                }
            }
            None => {
                let text = "the page sent what the server does not understand: reload the page".to_owned();
                if page.send(Outgoing::Message(Box::new(ServerMessage::Error { text }))).await.is_err() {
                    break;
                }
            }
        }
    }
    // the window's thread may be gone already
    let _ = to_window.send(Inbox::Closed);
    writer.abort();
}
