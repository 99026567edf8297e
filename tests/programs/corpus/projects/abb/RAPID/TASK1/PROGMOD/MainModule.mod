%%%
  VERSION:1
  LANGUAGE:ENGLISH
%%%

MODULE MainModule
  !***********************************************************
  ! Module:  MainModule
  ! loads parts from a rack, spot welds and stacks them
  !***********************************************************
  RECORD seat
    robtarget place;
    bool full;
  ENDRECORD
  CONST jointtarget jService:=[[0,-20,30,0,45,0],[9E+09,9E+09,9E+09,9E+09,9E+09,9E+09]];
  CONST robtarget pHome:=<0|gripper|wobj0>;
  CONST robtarget rack{2,2}:=[[<1|gripper|table>,<2|gripper|table>],
                              [<3|gripper|table>,<4|gripper|table>]];
  PERS seat stack{2}:=[[<5|gripper|fixture>,FALSE],[<6|gripper|fixture>,TRUE]];
  PERS num nCycle:=4711;
  VAR intnum irDoor;

  PROC main()
    rInit;
    WHILE DOutput(doStop)=0 DO
      FOR row FROM 1 TO 2 DO
        FOR col FROM 1 TO 2 DO
          rPick rack{row,col},gripper,table;
        ENDFOR
      ENDFOR
      Weld;
      rDrop stack{1}.place\Gentle;
      rDrop stack{2}.place;
      Incr nCycle;
      IF nCycle MOD 100=0 rService;
    ENDWHILE
    MoveJ pHome,v1000,fine,gripper;
  ERROR
    IF ERRNO=ERR_WAIT_MAXTIME THEN
      TPWrite "no part: MoveL pHome,v100,fine,gripper;";
      RETRY;
    ENDIF
  ENDPROC

  LOCAL PROC rInit()
    ConfJ\On;
    ConfL\On;
    AccSet 80,80;
    VelSet 100,2000;
    IDelete irDoor;
    CONNECT irDoor WITH tDoor;
    ISignalDI\Single,diDoor,1,irDoor;
    MoveAbsJ jService\NoEOffs,v500,z50,tool0;
    MoveJ pHome,v1000,z50,gripper\WObj:=wobj0;
  ENDPROC

  PROC rService()
    MoveAbsJ jService,v500,fine,tool0\WObj:=wobj0;
    Stop\NoRegain;
  ENDPROC

  TRAP tDoor
    StopMove;
    SetDO doHalt,1;
  ENDTRAP
ENDMODULE
