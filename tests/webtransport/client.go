// A client of webtransport-go: one trial of a server, as `run` asks for it; prints what it saw as JSON.
//
// Usage: client TRIAL ADDRESS HASH MESSAGES-AS-JSON. The version of the package is that of go.mod.

package main

import (
	"bytes"
	"context"
	"crypto/sha256"
	"crypto/tls"
	"crypto/x509"
	"encoding/hex"
	"encoding/json"
	"errors"
	"fmt"
	"io"
	"net/http"
	"os"
	"time"

	"github.com/quic-go/webtransport-go"
)

type messages struct{ Hello, Create, Join, Malformed string }

func unhex(text string) []byte {
	found, err := hex.DecodeString(text)
	if err != nil {
		panic(err)
	}
	return found
}

// Reads the next message, which is shorter than 128 bytes or has a length of two bytes.
func next(stream io.Reader) (byte, error) {
	length, shift := 0, 0
	one := make([]byte, 1)
	for {
		if _, err := io.ReadFull(stream, one); err != nil {
			return 0, err
		}
		length |= int(one[0]&0x7f) << shift
		if one[0] < 0x80 {
			break
		}
		shift += 7
	}
	message := make([]byte, length)
	_, err := io.ReadFull(stream, message)
	if err != nil {
		return 0, err
	}
	// A type from 0x80 on is of a later version, and means nothing to this one.
	if message[0] >= 0x80 {
		return next(stream)
	}
	return message[0], nil
}

func code(err error) any {
	var ended *webtransport.SessionError
	if errors.As(err, &ended) {
		return uint32(ended.ErrorCode)
	}
	return fmt.Sprint(err)
}

func try(trial, address, hash string, sent messages) (map[string]any, error) {
	saw := map[string]any{}
	ctx, cancel := context.WithTimeout(context.Background(), 10*time.Second)
	defer cancel()
	trust := &tls.Config{
		InsecureSkipVerify: true,
		VerifyPeerCertificate: func(chain [][]byte, _ [][]*x509.Certificate) error {
			if found := sha256.Sum256(chain[0]); !bytes.Equal(found[:], unhex(hash)) {
				return errors.New("another certificate")
			}
			return nil
		},
	}
	header, path := http.Header{}, "/rhumb/1"
	switch trial {
	case "origin":
		header.Set("Origin", "https://pages.example")
	case "path":
		path = "/rhumb/2"
	default:
		header.Set("Origin", "http://localhost")
	}
	response, session, err := dial(ctx, trust, "https://"+address+path, header)
	if response != nil {
		saw["status"] = response.StatusCode
	}
	if err != nil {
		saw["error"] = err.Error()
		return saw, nil
	}
	saw["protocol"] = chosen(session)
	stream, err := session.OpenStreamSync(ctx)
	if err != nil {
		return saw, err
	}
	say := func(message string) byte {
		if err != nil {
			return 0
		}
		if _, err = stream.Write(unhex(message)); err != nil {
			return 0
		}
		var kind byte
		kind, err = next(stream)
		return kind
	}
	saw["welcome"] = say(sent.Hello)
	switch trial {
	case "session":
		saw["created"] = say(sent.Create)
		saw["joined"] = say(sent.Join)
		if err != nil {
			return saw, err
		}
		datagram, err := session.ReceiveDatagram(ctx)
		if err != nil {
			return saw, err
		}
		saw["datagram"] = len(datagram)
		if _, err = stream.Write(unhex(sent.Malformed)); err != nil {
			return saw, err
		}
		for err == nil {
			_, err = next(stream)
		}
		<-session.Context().Done()
		saw["closed"] = code(context.Cause(session.Context()))
		if _, err := session.AcceptStream(ctx); err != nil {
			saw["closed"] = code(err)
		}
		return saw, nil
	case "close":
		if err != nil {
			return saw, err
		}
		if err := session.CloseWithError(9, "done"); err != nil {
			return saw, err
		}
		time.Sleep(time.Second)
	}
	return saw, err
}

func main() {
	var sent messages
	if err := json.Unmarshal([]byte(os.Args[4]), &sent); err != nil {
		panic(err)
	}
	saw, err := try(os.Args[1], os.Args[2], os.Args[3], sent)
	if err != nil {
		saw["error"] = err.Error()
	}
	if err := json.NewEncoder(os.Stdout).Encode(saw); err != nil {
		panic(err)
	}
}
