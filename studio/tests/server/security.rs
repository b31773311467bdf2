//! Who gets in.

use crate::client::Running;

#[test]
fn without_the_token_nobody_gets_anything() {
    let server = Running::start();
    let cookie = |value: &str| server.cookie().replace(&server.token, value);
    let wrong = cookie(&"0".repeat(server.token.len()));
    for path in ["/", "/index.html", "/socket", "/files/a/b", "/?token=", "/?token=0123456789abcdef0123456789abcdef"] {
        for headers in ["", &wrong, &cookie("")] {
            let (status, head, body) = server.http("GET", path, headers, b"");
            assert_eq!(status, 401, "{path} {headers}");
            assert!(!String::from_utf8_lossy(&body).contains("<script"), "{path}: {head}");
        }
    }
    assert_eq!(server.http("POST", "/upload?name=a.obj", "", b"v 0 0 0").0, 401);
    assert_eq!(server.socket(&[("Origin", &format!("http://{}", server.host))]).err(), Some(401));
    assert!(server.host.starts_with("127.0.0.1:"));
    assert_ne!(server.token, Running::start().token);
}

#[test]
fn the_token_becomes_a_cookie_that_scripts_and_other_sites_do_not_have() {
    let server = Running::start();
    let (status, head, _) = server.http("GET", &format!("/?token={}", server.token), "", b"");
    let head = head.to_lowercase();
    assert_eq!(status, 303);
    assert!(head.contains("location: /\r\n"), "{head}");
    let cookie = head.lines().find(|l| l.starts_with("set-cookie")).unwrap();
    assert!(cookie.contains("httponly") && cookie.contains("samesite=strict"), "{cookie}");
    let (status, head, body) = server.http("GET", "/", &server.cookie(), b"");
    assert_eq!(status, 200);
    assert!(String::from_utf8_lossy(&body).contains("<script type=\"module\""));
    let head = head.to_lowercase();
    let policy = head.lines().find(|l| l.starts_with("content-security-policy")).unwrap();
    assert!(policy.contains("default-src 'none'") && !policy.contains("unsafe"), "{policy}");
    assert!(head.contains("nosniff") && head.contains("no-referrer") && head.contains("no-store"));
    // nothing on the page is from elsewhere or inline
    let page = String::from_utf8_lossy(&body);
    assert!(!page.contains("http://") && !page.contains("https://") && !page.contains("<style"), "{page}");
}

#[test]
fn a_look_at_the_head_is_no_change() {
    let server = Running::start();
    assert_eq!(server.http("HEAD", "/", &server.cookie(), b"").0, 200);
}

#[test]
fn what_cannot_be_parsed_is_answered_in_words() {
    let server = Running::start();
    let headers = format!("{}Origin: http://{}\r\n", server.cookie(), server.host);
    let upgrade =
        "Connection: Upgrade\r\nUpgrade: websocket\r\nSec-WebSocket-Version: 13\r\nSec-WebSocket-Key: AA==\r\n";
    for (method, path, status) in [
        ("POST", "/upload", 400),
        ("POST", "/upload?name=a&name=b", 400),
        ("GET", "/socket?client=x", 400),
        ("GET", "/files/%FF/a.png", 404),
        ("GET", "/?token=a&token=b", 200),
    ] {
        let (given, _, body) = server.http(method, path, &format!("{headers}{upgrade}"), b"");
        let body = String::from_utf8_lossy(&body);
        let parser = ["deserialize", "duplicate", "digit", "UTF-8 in", "URL"].iter().find(|word| body.contains(**word));
        assert_eq!((given, parser), (status, None), "{path}: {body}");
    }
}

#[test]
fn a_download_has_its_own_name_in_any_script() {
    let server = Running::start();
    let at = server.hub.vault.add_bytes("Мя.zip", b"x").unwrap();
    let (status, head, _) = server.http("GET", &format!("/files/{}/%D0%9C%D1%8F.zip", at.asset), &server.cookie(), b"");
    assert!(status == 200 && head.contains("filename=\"__.zip\"; filename*=UTF-8''%D0%9C%D1%8F.zip"), "{head}");
}

#[test]
fn another_host_or_origin_is_refused() {
    let server = Running::start();
    let port = server.host.rsplit(':').next().unwrap();
    for host in [
        "evil.example".to_owned(),
        format!("evil.example:{port}"),
        format!("127.0.0.1.evil.example:{port}"),
        "127.0.0.1".to_owned(),
    ] {
        for path in ["/".to_owned(), format!("/?token={}", server.token)] {
            let (status, head, _) = server.http("GET", &path, &format!("Host: {host}\r\n{}", server.cookie()), b"");
            assert!((400..500).contains(&status), "{host}: {status}");
            assert!(!head.to_lowercase().contains("set-cookie"), "{host}");
        }
    }
    assert_eq!(server.http("GET", "/", &format!("Host: localhost:{port}\r\n{}", server.cookie()), b"").0, 200);
    let cookie = server.cookie();
    let cookie = cookie.trim().strip_prefix("Cookie: ").unwrap();
    for origin in [
        "http://evil.example",
        "null",
        "https://127.0.0.1",
        "file://",
        &format!("https://{}", server.host),
        &format!("http://{}.evil.example", server.host),
    ] {
        assert_eq!(server.socket(&[("Cookie", cookie), ("Origin", origin)]).err(), Some(403), "{origin}");
        let headers = format!("{}Origin: {origin}\r\n", server.cookie());
        assert_eq!(server.http("POST", "/upload?name=a.obj", &headers, b"v 0 0 0").0, 403, "{origin}");
        assert_eq!(server.http("GET", "/", &headers, b"").0, 403, "{origin}");
    }
    // a browser always says where a socket or an upload comes from
    assert_eq!(server.socket(&[("Cookie", cookie)]).err(), Some(403));
    assert_eq!(server.http("POST", "/upload?name=a.obj", &server.cookie(), b"v 0 0 0").0, 403);
}

#[test]
fn open_to_a_network_it_answers_under_numbers_but_under_no_other_name() {
    let server = Running::start_on([0, 0, 0, 0]);
    // what it prints works in a browser of this machine
    assert!(server.host.starts_with("127.0.0.1:"), "{}", server.host);
    let port = server.host.rsplit(':').next().unwrap();
    let status =
        |host: &str, more: &str| server.http("GET", "/", &format!("Host: {host}\r\n{more}{}", server.cookie()), b"").0;
    for own in ["127.0.0.1", "192.168.1.20", "10.0.0.5", "[::1]", "[fe80::1]", "localhost"] {
        let own = format!("{own}:{port}");
        assert_eq!(status(&own, ""), 200, "{own}");
        assert_eq!(status(&own, &format!("Origin: http://{own}\r\n")), 200, "{own}");
        assert_eq!(status(&own, &format!("Origin: http://10.9.9.9:{port}\r\n")), 403, "{own}");
    }
    for other in ["evil.example", "10.0.0.5.evil.example", "0x0a000005", "[::1", "127.1", ""] {
        assert_eq!(status(&format!("{other}:{port}"), ""), 421, "{other}");
    }
    assert_eq!(status("10.0.0.5:1", ""), 421);
    let (_, head, _) = server.http("GET", "/", &format!("Host: 10.0.0.5:{port}\r\n{}", server.cookie()), b"");
    assert!(head.contains(&format!("connect-src 'self' ws://10.0.0.5:{port};")), "{head}");
    // one address is one address
    let bound = Running::start();
    let port = bound.host.rsplit(':').next().unwrap();
    assert_eq!(bound.http("GET", "/", &format!("Host: 10.0.0.5:{port}\r\n{}", bound.cookie()), b"").0, 421);
}

#[test]
fn no_path_leads_out_of_the_vault() {
    let server = Running::start();
    let secret = server.folder.path().join("secret.txt");
    std::fs::write(&secret, "nobody reads this").unwrap();
    let known = server.hub.vault.add_bytes("a.png", b"\x89PNG").unwrap();
    let (status, head, body) = server.http("GET", &format!("/files/{}/a.png", known.asset), &server.cookie(), b"");
    assert!(status == 200 && body.windows(4).any(|w| w == b"\x89PNG"), "{head}");
    let other = server.hub.vault.add_bytes("a.html", b"<script>alert(1)</script>").unwrap();
    let (_, head, _) = server.http("GET", &format!("/files/{}/a.html", other.asset), &server.cookie(), b"");
    assert!(head.contains("attachment") && head.contains("octet-stream"), "{head}");
    for path in [
        format!("/files/{}/..%2F..%2F..%2Fsecret.txt", known.asset),
        format!("/files/{}/%2e%2e", known.asset),
        "/files/..%2F..%2Fassets/secret.txt".to_owned(),
        "/files/../secret.txt".to_owned(),
        format!("/files/{}/{}", known.asset, "%2Fetc%2Fpasswd"),
        format!("/files/{}/a%00.png", known.asset),
        format!("/files/{}/", "0".repeat(64)),
        "/../../etc/passwd".to_owned(),
    ] {
        let (status, _, body) = server.http("GET", &path, &server.cookie(), b"");
        assert!((400..500).contains(&status), "{path}: {status}");
        let body = String::from_utf8_lossy(&body);
        assert!(!body.contains("nobody reads") && !body.contains("root:x"), "{path}: {body}");
    }
    let headers = format!("{}Origin: http://{}\r\n", server.cookie(), server.host);
    for name in ["..%2Fevil.obj", "..", ".hidden", "%2Ftmp%2Fevil.obj", "a%00b.obj", "", "a%5Cb.obj"] {
        let (status, ..) = server.http("POST", &format!("/upload?name={name}"), &headers, b"v 0 0 0");
        assert_eq!(status, 400, "{name}");
    }
}
