"""Arrays, errors, files, memory, spatial algebra and frozen values: what every other package stands on."""
