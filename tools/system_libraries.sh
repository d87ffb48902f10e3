#!/usr/bin/env bash
# Open3D's and Mitsuba's wheels need a few system libraries; install what is missing, or say how.
set -eu
missing=()
need() { ldconfig -p | grep -q "$1" || missing+=("$2"); }
need 'libEGL\.so\.1' libegl1
need 'libGL\.so\.1' libgl1
need 'libX11\.so\.6' libx11-6
need 'libusb-1\.0\.so\.0' libusb-1.0-0
need 'libatomic\.so\.1' libatomic1
if ! python3 -c 'import venv, ensurepip' 2>/dev/null; then missing+=(python3-venv); fi
[ ${#missing[@]} -eq 0 ] && exit 0
command="apt-get update && apt-get install -y --no-install-recommends ${missing[*]}"
echo "system libraries missing: ${missing[*]}"
if [ "$(id -u)" = 0 ]; then
    sh -c "$command" >/dev/null && exit 0
elif sudo -n true 2>/dev/null; then
    sudo sh -c "$command" >/dev/null && exit 0
fi
echo "they could not be installed; as root, run: $command" >&2
exit 2
