"""The Cessna Citation for JSBSim: identified from recordings, generated, validated."""
