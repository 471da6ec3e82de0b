"""The aircraft behind MAVLink: JSBSim's Citation, its faults and sensors, and the bridge."""
