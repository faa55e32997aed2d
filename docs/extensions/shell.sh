# Read by bash before every shell block of the site (BASH_ENV): an error ends the build, and output is plain text.
set -e
unset FORCE_COLOR CLICOLOR CLICOLOR_FORCE
export TERM=dumb COLUMNS=80 OMP_NUM_THREADS=1
