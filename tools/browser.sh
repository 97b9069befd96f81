#!/usr/bin/env bash
# Have a headless Chromium for tests/algos/report/test_report_browser.py: the system's, or the one of its packages.
set -euo pipefail
for name in chromium-headless-shell chromium chromium-browser google-chrome; do
  if command -v "$name" >/dev/null; then exit 0; fi
done
[ "$(id -u)" = 0 ] && command -v apt-get >/dev/null || exit 1
install() {
  timeout 90 apt-get install -qq -y --no-install-recommends "$1" >/dev/null 2>&1
}
export DEBIAN_FRONTEND=noninteractive
install chromium-headless-shell && exit 0
timeout 45 apt-get update -qq >/dev/null 2>&1 || exit 1
install chromium-headless-shell || install chromium
