#!/bin/sh
# What a vehicle runs. With arguments: that leadline command. Without: the dive that /data/leadline.env describes, started
# again when it ends, each into a folder of its own; without that file, doctor says what is missing.
set -eu
[ $# -eq 0 ] || exec leadline "$@"
settings=${LEADLINE_SETTINGS:-leadline.env}
if [ ! -f "$settings" ]; then
    leadline doctor || true
    echo "leadline: no $settings: write LEADLINE_SOURCE=... and LEADLINE_OPTIONS='--rig rig.yaml --target sphere:0.34' into it (docs/vehicle.md)" >&2
    exit 2
fi
case $settings in /*) ;; *) settings=./$settings ;; esac # without a slash the shell would look in PATH
. "$settings"
exec leadline run "${LEADLINE_SOURCE:?}" --out "dives/$(date -u +%Y%m%dT%H%M%SZ)" ${LEADLINE_PAGE:+--view-at "$LEADLINE_PAGE"} --headless ${LEADLINE_OPTIONS:-}
