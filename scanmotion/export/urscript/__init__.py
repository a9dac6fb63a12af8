"""URScript for Universal Robots' arms, and the programme of the drive of their turntable."""
