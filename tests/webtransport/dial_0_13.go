//go:build v0_13

// The end of webtransport-go 0.13.

package main

import (
	"context"
	"crypto/tls"
	"net/http"

	"github.com/quic-go/quic-go"
	"github.com/quic-go/webtransport-go"
)

// The connection is this program's: the package would end its own at once with a session, before a close code has left.
func dial(ctx context.Context, trust *tls.Config, url string, header http.Header) (*http.Response, *webtransport.Session, error) {
	trust.NextProtos = []string{"h3"}
	request, err := http.NewRequest(http.MethodConnect, url, nil)
	if err != nil {
		return nil, nil, err
	}
	config := &quic.Config{EnableDatagrams: true, EnableStreamResetPartialDelivery: true}
	connection, err := quic.DialAddr(ctx, request.URL.Host, trust, config)
	if err != nil {
		return nil, nil, err
	}
	transport := webtransport.Transport{ApplicationProtocols: []string{"rhumb/1"}}
	client, err := transport.NewClientConn(connection)
	if err != nil {
		return nil, nil, err
	}
	return client.Dial(ctx, url, header)
}

func chosen(session *webtransport.Session) string {
	return session.SessionState().ApplicationProtocol
}
