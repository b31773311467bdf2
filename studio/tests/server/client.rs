//! A server on a vault of its own, and a page without a browser.

use std::io::{Read as _, Write as _};
use std::net::TcpStream;
use std::sync::Arc;
use std::time::Duration;

use serde_json::{Value, json};
use studio::case::{Case, FileRef, Source, Unit};
use studio::server::Server;
use studio::session::Hub;
use studio::vault::Vault;
use tempfile::TempDir;
use tungstenite::handshake::client::generate_key;
use tungstenite::{Message, WebSocket};

/// A server that runs until the test ends.
pub struct Running {
    pub hub: Arc<Hub>,
    pub host: String,
    pub token: String,
    pub folder: TempDir,
    _runtime: tokio::runtime::Runtime,
}

impl Running {
    pub fn start() -> Self {
        Self::start_on([127, 0, 0, 1])
    }

    pub fn start_on(address: [u8; 4]) -> Self {
        let folder = tempfile::tempdir().unwrap();
        let hub = Arc::new(Hub::new(Vault::open(folder.path()).unwrap()));
        let runtime = tokio::runtime::Builder::new_multi_thread().worker_threads(2).enable_all().build().unwrap();
        let server = runtime.block_on(Server::bind(hub.clone(), address.into(), 0)).unwrap();
        let address = server.address();
        let (host, token) = address.strip_prefix("http://").unwrap().split_once("/?token=").unwrap();
        let (host, token) = (host.to_owned(), token.to_owned());
        runtime.spawn(server.run());
        Self { hub, host, token, folder, _runtime: runtime }
    }

    pub fn cookie(&self) -> String {
        let port = self.host.rsplit(':').next().unwrap();
        format!("Cookie: nonrigid_studio_{port}={}\r\n", self.token)
    }

    /// Status, head and body of an answer. `extra` are whole header lines; `Host` is the server's unless it is given.
    pub fn http(&self, method: &str, path: &str, extra: &str, body: &[u8]) -> (u16, String, Vec<u8>) {
        let mut stream = TcpStream::connect(&self.host).unwrap();
        stream.set_read_timeout(Some(Duration::from_secs(20))).unwrap();
        let host = if extra.contains("Host:") { String::new() } else { format!("Host: {}\r\n", self.host) };
        let length = body.len();
        write!(
            stream,
            "{method} {path} HTTP/1.1\r\n{host}{extra}Content-Length: {length}\r\nConnection: close\r\n\r\n"
        )
        .unwrap();
        stream.write_all(body).unwrap();
        let mut answer = Vec::new();
        stream.read_to_end(&mut answer).unwrap();
        let end = answer.windows(4).position(|w| w == b"\r\n\r\n").unwrap();
        let head = String::from_utf8_lossy(&answer[..end]).into_owned();
        let status = head.split(' ').nth(1).unwrap().parse().unwrap();
        (status, head, answer[end + 4..].to_vec())
    }

    /// Opens a WebSocket with these header lines.
    pub fn socket(&self, headers: &[(&str, &str)]) -> Result<Page, u16> {
        self.socket_of("", headers)
    }

    fn socket_of(&self, query: &str, headers: &[(&str, &str)]) -> Result<Page, u16> {
        let stream = TcpStream::connect(&self.host).unwrap();
        stream.set_read_timeout(Some(Duration::from_secs(60))).unwrap();
        let mut request = tungstenite::http::Request::builder()
            .uri(format!("ws://{}/socket{query}", self.host))
            .header("Host", &self.host)
            .header("Connection", "Upgrade")
            .header("Upgrade", "websocket")
            .header("Sec-WebSocket-Version", "13")
            .header("Sec-WebSocket-Key", generate_key());
        for (name, value) in headers {
            request = request.header(*name, *value);
        }
        match tungstenite::client(request.body(()).unwrap(), stream) {
            Ok((socket, _)) => Ok(Page(socket, Value::Null)),
            Err(tungstenite::HandshakeError::Failure(tungstenite::Error::Http(answer))) => {
                Err(answer.status().as_u16())
            }
            Err(error) => panic!("{error}"),
        }
    }

    pub fn page(&self) -> Page {
        self.page_of("")
    }

    /// A page that has shown a client before, as its query says.
    pub fn page_of(&self, query: &str) -> Page {
        let cookie = self.cookie();
        let cookie = cookie.trim().strip_prefix("Cookie: ").unwrap();
        let headers = [("Cookie", cookie), ("Origin", &format!("http://{}", self.host))];
        let mut page = self.socket_of(query, &headers).unwrap();
        page.wait("cases");
        page
    }

    /// A file of the vault, in millimetres.
    pub fn source(&self, name: &str, text: &str) -> Source {
        let at = self.hub.vault.add_bytes(name, text.as_bytes()).unwrap();
        Source { at, name: name.to_owned(), unit: Unit::Mm }
    }

    /// A case of a bumpy sheet, 100 mm wide, as template and as scan.
    pub fn add_sheet(&self) -> u32 {
        let source = self.source("sheet.obj", &sheet());
        let case = Case { template: Some(source.clone()), scans: vec![source], scan: Some(0), ..Case::default() };
        self.hub.vault.add_case(&case).unwrap()
    }

    /// A server with one such case, its number, and a page that shows it.
    pub fn with_sheet() -> (Self, u32, Page) {
        let server = Self::start();
        let id = server.add_sheet();
        let page = server.page_of_case();
        (server, id, page)
    }

    /// A server, and a page that shows a case without files.
    pub fn with_empty_case() -> (Self, Page) {
        let server = Self::start();
        let mut page = server.page();
        page.send(&json!({ "type": "new_case", "name": "A" }));
        page.wait("case");
        (server, page)
    }

    /// A page that shows the case that was added last.
    pub fn page_of_case(&self) -> Page {
        let mut page = self.page();
        page.wait("case");
        page
    }

    /// How many uploads the vault keeps that have joined no case.
    pub fn waiting(&self) -> usize {
        std::fs::read_dir(self.folder.path().join("incoming")).unwrap().count()
    }

    pub fn upload(&self, name: &str, bytes: &[u8]) -> String {
        let origin = format!("{}Origin: http://{}\r\n", self.cookie(), self.host);
        let (status, _, body) = self.http("POST", &format!("/upload?name={name}"), &origin, bytes);
        let body = String::from_utf8(body).unwrap();
        assert_eq!(status, 200, "{body}");
        body
    }

    /// Uploads files; the message that adds them to the case.
    pub fn adding(&self, role: &str, files: &[(&str, &[u8])], unit: Option<&str>) -> Value {
        let upload = |(name, bytes): &(&str, &[u8])| json!({ "id": self.upload(name, bytes), "name": name });
        json!({ "type": "add", "role": role, "files": files.iter().map(upload).collect::<Vec<_>>(), "unit": unit })
    }
}

/// The message of an edit.
pub fn edit(edit: Value) -> Value {
    json!({ "type": "edit", "edit": edit })
}

pub fn sheet() -> String {
    scaled_sheet(1.0)
}

pub fn scaled_sheet(unit: f64) -> String {
    let n = 21;
    let mut text = String::new();
    for k in 0..n * n {
        let (x, y) = (5.0 * f64::from(k % n), 7.0 * f64::from(k / n));
        let z = 20.0 * (x / 30.0).sin() * (y / 50.0).cos() + 0.002 * x * y;
        text += &format!("v {} {} {}\n", unit * x, unit * y, unit * z);
    }
    for r in 0..n - 1 {
        for c in 1..n {
            let a = r * n + c;
            text += &format!("f {} {} {} {}\n", a, a + 1, a + n + 1, a + n);
        }
    }
    text
}

pub fn no_file() -> FileRef {
    FileRef { asset: "0".repeat(64), file: "x.obj".to_owned() }
}

/// A page without a browser, and the case that it was shown last.
pub struct Page(WebSocket<TcpStream>, Value);

impl Page {
    /// Sends a message for the case that is shown; an edit is made on what is shown.
    pub fn send(&mut self, message: &Value) {
        let mut message = message.clone();
        message["case"] = self.1["id"].clone();
        if message["type"] == "edit" {
            message["plan"] = self.1["case"]["plan"].clone();
            message["revision"] = self.1["revision"].clone();
        }
        self.text(&message.to_string());
    }

    pub fn text(&mut self, text: &str) {
        self.0.send(Message::text(text)).unwrap();
    }

    pub fn bytes(&mut self, bytes: &[u8]) {
        self.0.send(Message::binary(bytes.to_vec())).unwrap();
    }

    /// The next message of this type.
    pub fn wait(&mut self, kind: &str) -> Value {
        loop {
            let message = self.next();
            if message["type"] == kind {
                return message;
            }
        }
    }

    /// The next message that is no numbers.
    pub fn next(&mut self) -> Value {
        loop {
            let (message, _) = self.anything();
            if message["type"].is_string() {
                return message;
            }
        }
    }

    /// The next message, or the header of the next numbers and what follows it.
    pub fn anything(&mut self) -> (Value, Vec<u8>) {
        loop {
            match self.0.read().unwrap() {
                Message::Text(text) => {
                    let message: Value = serde_json::from_str(&text).unwrap();
                    if message["type"] == "case" {
                        self.1.clone_from(&message);
                    }
                    return (message, Vec::new());
                }
                Message::Binary(bytes) => {
                    let length = u32::from_le_bytes(bytes[..4].try_into().unwrap()) as usize;
                    let header = serde_json::from_slice(&bytes[4..4 + length]).unwrap();
                    return (header, bytes[4 + length..].to_vec());
                }
                _ => {}
            }
        }
    }

    /// The header of the next numbers in a slot.
    pub fn numbers(&mut self, slot: &str) -> Value {
        loop {
            let (header, _) = self.anything();
            if header["slot"] == slot {
                return header;
            }
        }
    }

    /// The error that a message is answered with.
    pub fn refused(&mut self, message: &Value) -> String {
        self.send(message);
        self.wait("error")["text"].as_str().unwrap().to_owned()
    }
}
