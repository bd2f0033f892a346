//! Origins of web pages that a server lets connect.
//!
//! The browser names the page's origin in its request, and no page can change that. A client that is no browser names
//! none and is let in: a token decides about it.

use std::fmt;
use std::net::IpAddr;
use std::str::FromStr;

/// The origins of pages that may connect.
///
/// Pages of this machine may always: their origin is `localhost` or a loopback address.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Origins {
    allowed: Vec<PageOrigin>,
}

/// The origin of a page, as a browser writes it: scheme, host, and port unless it is the scheme's own.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct PageOrigin {
    text: String,
}

/// A text that is neither an origin nor `*`.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct InvalidPageOrigin {
    text: String,
}

impl Origins {
    /// Pages of this machine alone.
    #[must_use]
    pub const fn loopback() -> Self {
        Self {
            allowed: Vec::new(),
        }
    }

    /// Lets pages of one more origin connect.
    pub fn allow(&mut self, origin: PageOrigin) {
        self.allowed.push(origin);
    }

    /// True if a page of this origin may connect; `None` is a client that is no browser.
    #[must_use]
    pub fn allows(&self, origin: Option<&str>) -> bool {
        let Some(origin) = origin else {
            return true;
        };
        let origin = origin.to_ascii_lowercase();
        is_loopback(&origin)
            || (self.allowed.iter())
                .any(|allowed| allowed.text == PageOrigin::ANY || allowed.text == origin)
    }
}

impl FromIterator<PageOrigin> for Origins {
    fn from_iter<T: IntoIterator<Item = PageOrigin>>(origins: T) -> Self {
        Self {
            allowed: origins.into_iter().collect(),
        }
    }
}

impl PageOrigin {
    /// The text that stands for every origin.
    const ANY: &str = "*";
}

/// The host of an origin, without its port; `None` for a text that is none.
fn host(origin: &str) -> Option<&str> {
    let (scheme, rest) = origin.split_once("://")?;
    if !matches!(scheme, "http" | "https") {
        return None;
    }
    let (host, port) = match rest.strip_prefix('[') {
        Some(rest) => {
            let (host, port) = rest.split_once(']')?;
            host.parse::<std::net::Ipv6Addr>().ok()?;
            (
                host,
                port.strip_prefix(':').or(port.is_empty().then_some("0")),
            )
        }
        None => match rest.split_once(':') {
            Some((host, port)) => (host, Some(port)),
            None => (rest, Some("0")),
        },
    };
    port?.parse::<u16>().ok()?;
    let is_host = |c: char| c.is_ascii_alphanumeric() || matches!(c, '-' | '.' | '_' | ':');
    (!host.is_empty() && host.chars().all(is_host)).then_some(host)
}

fn is_loopback(origin: &str) -> bool {
    host(origin).is_some_and(|host| {
        host == "localhost" || host.parse::<IpAddr>().is_ok_and(|at| at.is_loopback())
    })
}

impl FromStr for PageOrigin {
    type Err = InvalidPageOrigin;

    fn from_str(text: &str) -> Result<Self, InvalidPageOrigin> {
        let lower = text.to_ascii_lowercase();
        if lower != Self::ANY && host(&lower).is_none() {
            return Err(InvalidPageOrigin { text: text.into() });
        }
        Ok(Self { text: lower })
    }
}

impl fmt::Display for PageOrigin {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        self.text.fmt(f)
    }
}

impl fmt::Display for InvalidPageOrigin {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(
            f,
            "{:?} is not an origin: write https://host, https://host:port, or * for all",
            self.text
        )
    }
}

impl std::error::Error for InvalidPageOrigin {}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn pages_of_this_machine_and_clients_without_a_page_may_connect() {
        let origins = Origins::loopback();
        for origin in [
            None,
            Some("http://localhost"),
            Some("http://localhost:8080"),
            Some("https://127.0.0.1:4433"),
            Some("http://127.3.2.1"),
            Some("http://[::1]:80"),
        ] {
            assert!(origins.allows(origin), "{origin:?}");
        }
        for origin in [
            "https://example.org",
            "https://localhost.example.org",
            "http://127.0.0.1.example.org",
            "http://[::2]",
            "null",
            "file://",
            "",
            "http://localhost:80:80",
            "http://localhost/x",
        ] {
            assert!(!origins.allows(Some(origin)), "{origin}");
        }
    }

    #[test]
    fn an_allowed_origin_is_compared_whole_and_a_star_allows_all() {
        let one: Origins = ["https://Example.org:8443".parse().unwrap()]
            .into_iter()
            .collect();
        assert!(one.allows(Some("https://example.org:8443")));
        assert!(!one.allows(Some("https://example.org")));
        assert!(!one.allows(Some("http://example.org:8443")));
        let mut all = Origins::loopback();
        all.allow("*".parse().unwrap());
        assert!(all.allows(Some("https://example.net")) && all.allows(Some("null")));
    }

    #[test]
    fn a_text_that_is_no_origin_is_refused_with_the_form_to_write() {
        for text in [
            "",
            "example.org",
            "https://",
            "ftp://host",
            "https://a/b",
            "https://a:b",
        ] {
            let error = text.parse::<PageOrigin>().unwrap_err().to_string();
            assert!(error.contains("https://host"), "{error}");
        }
    }
}
