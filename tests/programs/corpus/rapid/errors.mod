MODULE Errors
  VAR errnum ERR_GRIP:=-1;
  VAR intnum intDoor;
  CONST robtarget pGrip:=<36|gripper|wobj0>;
  CONST robtarget pSafe:=<37|gripper|wobj0>;
  PROC main()
    BookErrNo ERR_GRIP;
    CONNECT intDoor WITH door;
    ISignalDI diDoor,1,intDoor;
    grip;
    UNDO
      Reset doVac;
  ENDPROC
  PROC grip()
    MoveL pGrip,v100,fine,gripper;
    IF diVac=0 RAISE ERR_GRIP;
    BACKWARD
      MoveL pSafe,v100,fine,gripper;
    ERROR (ERR_GRIP)
      StorePath;
      MoveJ pSafe,v200,fine,gripper;
      RestoPath;
      TRYNEXT;
  ENDPROC
  TRAP door
    VAR robtarget pStop;
    StopMove;
    pStop:=CRobT(\Tool:=gripper\WObj:=wobj0);
  ENDTRAP
ENDMODULE
