//! Answers requests for figures and for the server's health.
//!
//! It shares no lock with a scene for longer than a copy takes, so that it answers whatever a scene does.

use hyper::StatusCode;

use super::Metrics;
use crate::http::{HttpAnswer, HttpRequest, TEXT};

/// The type of figures, as Prometheus reads them.
const FIGURES: &str = "text/plain; version=0.0.4";

impl Metrics {
    /// The answer to a request.
    pub(crate) fn answer(&self, request: &HttpRequest) -> HttpAnswer {
        match request.path.as_str() {
            "/metrics" => HttpAnswer::ok(FIGURES, self.text()),
            "/health" if self.is_healthy() => HttpAnswer::ok(TEXT, "ok\n"),
            "/health" => HttpAnswer::refusal(
                StatusCode::SERVICE_UNAVAILABLE,
                "the dispatcher does not answer",
            ),
            _ => HttpAnswer::refusal(StatusCode::NOT_FOUND, "there are /metrics and /health"),
        }
    }
}
