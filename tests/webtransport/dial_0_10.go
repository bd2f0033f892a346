//go:build v0_10

// The end of webtransport-go 0.10.

package main

import (
	"context"
	"crypto/tls"
	"net/http"

	"github.com/quic-go/webtransport-go"
)

func dial(ctx context.Context, trust *tls.Config, url string, header http.Header) (*http.Response, *webtransport.Session, error) {
	dialer := webtransport.Dialer{TLSClientConfig: trust, ApplicationProtocols: []string{"rhumb/1"}}
	return dialer.Dial(ctx, url, header)
}

func chosen(session *webtransport.Session) string {
	return session.SessionState().ApplicationProtocol
}
